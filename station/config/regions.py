"""Tables `[[keep_out]]`: regions of the workspace that the tubes must not enter, or must not leave."""

import math
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from core.errors import CtrError
from core.robot.keep_out import KeepOut
from core.robot.regions import Mesh, Region, mesh
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
        """Return the numbers of `Region`."""
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
    """file of the surface, relative to this file"""
    scale: Positive = 0.001
    """length of the file's unit; most files are in millimetres [m]"""
    position: Point = (0.0, 0.0, 0.0)
    """position of the file's origin, world frame [m]"""
    rotation_vector: Vector = (0.0, 0.0, 0.0)
    """rotation of the file's axes: axis times angle [rad]"""

    def surface(self) -> Mesh:
        """Return the mesh in the world frame; raises ConfigError."""
        path = Path(self.file)
        try:
            changed = path.stat().st_mtime_ns
        except OSError as error:
            raise ConfigError(f"region '{self.name}': {path}: cannot be read: {error.strerror}") from None
        return _mesh(path, changed, self.scale, self.position, self.rotation_vector)


RegionFile = Annotated[
    SphereRegion | CapsuleRegion | BoxRegion | HalfSpaceRegion | MeshRegion, Field(discriminator="kind")
]
#: Regions of a station or of an experiment.
Regions = Annotated[tuple[RegionFile, ...], Row, Field(max_length=20)]


@lru_cache(maxsize=8)
def _mesh(
    path: Path, _changed: int, scale: float, position: tuple[float, float, float], turn: tuple[float, float, float]
) -> Mesh:  # fmt: skip
    """Return the mesh of a file that was last changed at `_changed` [ns], so that an edited file is read again."""
    import trimesh  # only for meshes, because its import takes a second

    try:
        read = trimesh.load(path, force="mesh")
    except Exception as error:  # each format's reader raises its own errors
        raise ConfigError(f"{path}: not a surface that can be read (STL, PLY, OBJ): {error}") from None
    if not isinstance(read, trimesh.Trimesh) or not read.is_watertight:
        raise ConfigError(f"{path}: the surface is not closed; repair its holes, for example in MeshLab")
    if read.volume < 0.0:
        read.invert()
    base = Base(position, turn)
    try:
        return mesh(scale * np.asarray(read.triangles, np.float64) @ base.rotation.T + np.array(position))
    except CtrError as error:
        raise ConfigError(f"{path}: {error}") from None


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
