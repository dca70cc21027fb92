"""Tables `[[keep_out]]`: regions of the workspace that the tubes must not enter, or must not leave."""

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, PrivateAttr

from core.errors import CtrError
from core.robot.closed_surface import ClosedSurface, closed_surface
from core.robot.keep_out import KeepOut
from core.robot.regions import Mesh, Region
from core.robot.robot import Base
from station.config.strict import ConfigError, Direction, Positive, Row, Strict, Vector

#: Largest coordinate of a region [m].
MAX_COORDINATE_M = 10.0
Coordinate = Annotated[float, Field(ge=-MAX_COORDINATE_M, le=MAX_COORDINATE_M)]
Point = Annotated[tuple[Coordinate, Coordinate, Coordinate], Row]


class _RegionFile(Strict):
    name: Annotated[str, Field(min_length=1, max_length=60)]
    """name of the region in messages and in the scene"""
    margin: Annotated[float, Field(ge=0.0, le=0.1)] = 0.001
    """smallest allowed distance between the region and the surface of the tubes, at most 0.1 [m]"""
    inside: bool = False
    """true: the tubes must stay inside the region, for example in a lumen"""

    def numbers(self) -> tuple[float, ...]:
        """Return the numbers that define the region, as `Region` expects them."""
        return ()

    def surface(self) -> Mesh | None:
        """Return the region's mesh; None: the region has none."""
        return None


class SphereRegion(_RegionFile):
    """A sphere."""

    kind: Literal["sphere"] = "sphere"
    centre: Point
    """centre, world frame [m]"""
    radius: Positive
    """radius [m]"""

    def numbers(self) -> tuple[float, ...]:
        """Return centre and radius."""
        return (*self.centre, self.radius)


class CapsuleRegion(_RegionFile):
    """A cylinder with a half sphere at each end, for example a rib or a tube."""

    kind: Literal["capsule"] = "capsule"
    start: Point
    """start of the axis, world frame [m]"""
    end: Point
    """end of the axis, world frame [m]"""
    radius: Positive
    """radius [m]"""

    def numbers(self) -> tuple[float, ...]:
        """Return both ends and the radius."""
        return (*self.start, *self.end, self.radius)


class BoxRegion(_RegionFile):
    """A box."""

    kind: Literal["box"] = "box"
    centre: Point
    """centre, world frame [m]"""
    edges: Annotated[tuple[Positive, Positive, Positive], Row]
    """lengths of the edges along the axes of the box [m]"""
    rotation_vector: Vector = (0.0, 0.0, 0.0)
    """rotation of the box: axis times angle [rad]"""

    def numbers(self) -> tuple[float, ...]:
        """Return centre, half edges and rotation."""
        rotation = Base((0.0, 0.0, 0.0), self.rotation_vector).rotation
        return (*self.centre, *(0.5 * edge for edge in self.edges), *rotation.ravel().tolist())


class HalfSpaceRegion(_RegionFile):
    """Everything on one side of a plane, for example a table."""

    kind: Literal["half_space"] = "half_space"
    point: Point
    """point of the plane, world frame [m]"""
    normal: Direction
    """direction out of the region; its length does not matter"""

    def numbers(self) -> tuple[float, ...]:
        """Return point and unit normal."""
        length = math.hypot(*self.normal)
        return (*self.point, *(one / length for one in self.normal))


class MeshRegion(_RegionFile):
    """The inside of a closed surface from a file (STL, PLY, OBJ)."""

    kind: Literal["mesh"] = "mesh"
    file: Annotated[str, Field(min_length=1, max_length=500)]
    """file of the surface, relative to this file; a station reads it once, at its start"""
    scale: Positive = 0.001
    """length of one unit of the file; the default is for files in millimetres [m]"""
    position: Point = (0.0, 0.0, 0.0)
    """position of the file's origin, world frame [m]"""
    rotation_vector: Vector = (0.0, 0.0, 0.0)
    """rotation of the file's axes: axis times angle [rad]"""

    _read: "MeshFile | None" = PrivateAttr(None)

    def surface(self) -> Mesh:
        """Return the mesh in the world frame; raises ConfigError."""
        return self.content.mesh

    @property
    def content(self) -> "MeshFile":
        """The file's content: as it was read by `read_regions`, otherwise as it is now; raises ConfigError."""
        return self._read or _read_mesh(self)

    def read(self) -> Self:
        """Return this region with its file's content, so that later changes of the file do not change the region.

        Regions with the same keys are equal if their files had the same content. Raises ConfigError.
        """
        found = self.model_copy()
        found._read = self.content
        return found


@dataclass(frozen=True)
class MeshFile:
    """Content of a mesh's file."""

    mesh: Mesh = field(compare=False, repr=False)  #: world frame [m]
    sha256: str  #: hash of the file
    turned: int  #: number of triangles that faced inward in the file


RegionFile = Annotated[
    SphereRegion | CapsuleRegion | BoxRegion | HalfSpaceRegion | MeshRegion, Field(discriminator="kind")
]
#: Regions of a station or of an experiment.
Regions = Annotated[tuple[RegionFile, ...], Row, Field(max_length=20)]


#: Largest file of a mesh [bytes]; the largest number of triangles in text takes 30 MB.
MAX_FILE_BYTES = 100_000_000
#: File formats of meshes.
FORMATS = ("stl", "ply", "obj")


def _read_mesh(region: MeshRegion) -> MeshFile:
    """Return the content of a region's file.

    Raises:
        ConfigError: the file cannot be read, or is not a closed surface of a plausible size.
    """
    path, name = Path(region.file), f"region '{region.name}': {region.file}"
    kind = path.suffix.lower().removeprefix(".")
    try:
        if path.exists() and not path.is_file():
            raise ConfigError(f"{name}: not a file; give an STL, PLY or OBJ file")
        if (size := path.stat().st_size) > MAX_FILE_BYTES:
            raise ConfigError(
                f"{name}: {size / 1e6:.0f} MB is above {MAX_FILE_BYTES / 1e6:.0f} MB; reduce its triangles"
            )
        content = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{name}: cannot be read: {error.strerror}") from None
    try:
        found = _surface(content, kind, region.scale, region.position, region.rotation_vector)
    except CtrError as error:
        raise ConfigError(f"{name}: {error}") from None
    return MeshFile(found.mesh, hashlib.sha256(content).hexdigest(), found.turned)


@lru_cache(maxsize=4)  # the cases of an experiment often have the same mesh
def _surface(
    content: bytes, kind: str, scale: float, position: tuple[float, float, float], turn: tuple[float, float, float]
) -> ClosedSurface:
    """Return the surface of a file's content, in the world frame.

    Raises:
        ConfigError, DescriptionError: the content is not a closed surface of a plausible size.
    """
    import trimesh  # only for meshes, because its import takes a second

    try:
        if kind not in FORMATS:
            raise ValueError(f"the file name must end in one of {', '.join(FORMATS)}")
        read = trimesh.load(BytesIO(content), file_type=kind, force="mesh", process=False)
        corners = np.asarray(getattr(read, "triangles", ()), np.float64)
        if not len(corners):
            raise ValueError("it has no triangles")
    except Exception as error:  # each format's reader raises its own errors
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ConfigError(f"not a surface that can be read (STL, PLY, OBJ): {reason[:200]}") from None
    with np.errstate(over="ignore", invalid="ignore"):
        placed = scale * corners @ Base(position, turn).rotation.T + np.array(position)
    return closed_surface(placed)


def read_regions(regions: Sequence[RegionFile]) -> tuple[RegionFile, ...]:
    """Return regions with the content of their files, which are read once; raises ConfigError."""
    return tuple(one.read() if isinstance(one, MeshRegion) else one for one in regions)


def mesh_warnings(regions: Sequence[RegionFile]) -> tuple[str, ...]:
    """Return a warning for each region whose file has triangles that face inward; raises ConfigError."""
    return tuple(
        f"region '{one.name}': {found.turned} of {len(found.mesh.triangles)} triangles of {one.file} face inward and"
        " were turned outward; check the region in the scene, or export the file again"
        for one in regions
        if isinstance(one, MeshRegion) and (found := one.content).turned
    )


def mesh_hashes(regions: Sequence[RegionFile]) -> dict[str, str]:
    """Return the SHA-256 of the file of each mesh by the name of its region; raises ConfigError."""
    return {one.name: one.content.sha256 for one in regions if isinstance(one, MeshRegion)}


def keep_out(regions: Sequence[RegionFile]) -> tuple[KeepOut, ...]:
    """Return the limits of these regions.

    Raises:
        ConfigError: the file of a mesh cannot be read, or two regions have one name.
    """
    names = [one.name for one in regions]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"keep_out: two regions have the name '{name}'")
    found: list[KeepOut] = []
    for one in regions:
        surface = one.surface()
        region = Region(one.name, one.kind, one.numbers(), inside=one.inside, margin=one.margin)
        found.append(KeepOut(region if surface is None else Region(**{**vars(region), "mesh": surface})))
    return tuple(found)


def resolved(region: RegionFile, folder: Path) -> RegionFile:
    """Return a region whose file is relative to the working directory instead of `folder`."""
    return region.model_copy(update={"file": str(folder / region.file)}) if region.kind == "mesh" else region
