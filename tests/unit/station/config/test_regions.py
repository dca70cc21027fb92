"""Tables `[[keep_out]]` are read strictly, and meshes are checked."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from pydantic import TypeAdapter

from core.robot.keep_out import KeepOut
from station.config.regions import MeshRegion, Regions, keep_out, resolved
from station.config.strict import ConfigError
from station.service.station_file import load_station

REGIONS = TypeAdapter(Regions)


def test_a_plane_and_a_box_have_unit_normals_and_half_edges() -> None:
    plane, box = keep_out(
        REGIONS.validate_python(
            [
                {"name": "table", "kind": "half_space", "point": [0.08, 0, 0], "normal": [-2.0, 0, 0]},
                {"name": "box", "kind": "box", "centre": [0, 0, 0.1], "edges": [0.02, 0.04, 0.06], "margin": 0.002},
            ]
        )
    )
    assert plane.region.distance(np.array([0.07, 0.3, 0.2]))[0] == pytest.approx(0.01)
    assert box.region.distance(np.array([0.0, 0.025, 0.1]))[0] == pytest.approx(0.005)
    assert box.region.margin == 0.002


def test_a_mesh_is_scaled_and_placed(tmp_path: Path) -> None:
    trimesh.creation.icosphere(subdivisions=3, radius=10.0).export(tmp_path / "ball.stl")  # millimetres
    ball = MeshRegion(name="ball", file="ball.stl", position=(0.0, 0.0, 0.1))
    (limit,) = keep_out([resolved(ball, tmp_path)])

    assert limit.region.distance(np.array([0.015, 0.0, 0.1]))[0] == pytest.approx(0.005, abs=1e-4)
    assert limit.region.distance(np.array([0.002, 0.0, 0.1]))[0] == pytest.approx(-0.008, abs=1e-4)


def test_an_open_surface_a_missing_file_and_a_repeated_name_are_refused(tmp_path: Path) -> None:
    body = trimesh.creation.box((10.0, 10.0, 10.0))
    body.update_faces(np.arange(len(body.faces)) > 0)
    body.export(tmp_path / "open.stl")
    (tmp_path / "text.stl").write_text("no surface")
    for name, message in (
        ("open", "not closed"),
        ("text", "not closed|cannot be read|not a surface"),
        ("no", "No such"),
    ):
        with pytest.raises(ConfigError, match=message):
            keep_out([MeshRegion(name=name, file=str(tmp_path / f"{name}.stl"))])
    ball = {"name": "ball", "kind": "sphere", "centre": [0, 0, 0.3], "radius": 0.01}
    with pytest.raises(ConfigError, match="two regions have the name 'ball'"):
        keep_out(REGIONS.validate_python([ball, ball]))


def test_the_regions_of_a_station_limit_every_motion_and_its_park_pose_is_checked(tmp_path: Path) -> None:
    text = "[[keep_out]]\nname = 'ball'\nkind = 'sphere'\nradius = 0.01\ncentre = "
    file = tmp_path / "station.toml"
    file.write_text(f"{text}[0.0, 0.0, 0.5]\n")
    rig = load_station(file).bench()
    assert [limit.region.name for limit in rig.limits.others if isinstance(limit, KeepOut)] == ["ball"]
    assert rig.control.controller.limits == rig.limits

    file.write_text(f"{text}[0.0, 0.0, 0.1]\n")
    with pytest.raises(ConfigError, match="the region 'ball' near"):
        load_station(file).bench()
