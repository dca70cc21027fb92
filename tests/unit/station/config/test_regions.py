"""Tables `[[keep_out]]` are read strictly, and meshes are checked."""

import hashlib
import os
from pathlib import Path

import numpy as np
import pytest
import trimesh
from pydantic import TypeAdapter

from core.robot.keep_out import KeepOut
from station.config.regions import MeshRegion, Regions, keep_out, mesh_hashes, read_regions, resolved
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
    for name, message in (("open", "not closed"), ("text", "not a surface that can be read"), ("no", "No such")):
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


def test_a_mesh_with_turned_triangles_is_used_with_a_warning_for_the_operator(tmp_path: Path) -> None:
    body = trimesh.creation.box((10.0, 10.0, 10.0), trimesh.transformations.translation_matrix((0.0, 0.0, 500.0)))
    body.faces[3] = body.faces[3][::-1]
    body.export(tmp_path / "box.stl")
    file = tmp_path / "station.toml"
    file.write_text("[[keep_out]]\nname = 'box'\nkind = 'mesh'\nfile = 'box.stl'\n")
    rig = load_station(file).bench()

    assert [text for text in rig.warnings if "1 of 12 triangles" in text and "were turned outward" in text]
    (limit,) = (one for one in rig.limits.others if isinstance(one, KeepOut))
    assert limit.region.distance(np.array([0.0, 0.0, 0.5]))[0] == pytest.approx(-0.005)


@pytest.mark.parametrize("scale", [1e-300, 1e-15, 1e-6, 1.0, 1e300])
def test_a_mesh_of_an_impossible_size_is_refused_with_its_size_and_its_unit(tmp_path: Path, scale: float) -> None:
    trimesh.creation.box((10.0, 20.0, 30.0)).export(tmp_path / "box.stl")
    with pytest.raises(ConfigError, match=r"box.stl: a mesh of \d.* is its unit right\?") as refused:
        keep_out([MeshRegion(name="box", file=str(tmp_path / "box.stl"), scale=scale)])
    assert "of -" not in str(refused.value)


def test_a_region_stays_as_it_was_read_when_its_file_is_replaced(tmp_path: Path) -> None:
    file, point = tmp_path / "ball.stl", np.array([0.015, 0.0, 0.5])
    trimesh.creation.icosphere(subdivisions=3, radius=10.0).export(file)
    station = tmp_path / "station.toml"
    station.write_text("[[keep_out]]\nname = 'ball'\nkind = 'mesh'\nfile = 'ball.stl'\nposition = [0.0, 0.0, 0.5]\n")
    rig = load_station(station).bench()
    before = mesh_hashes(rig.keep_out)
    assert before == {"ball": hashlib.sha256(file.read_bytes()).hexdigest()}
    trimesh.creation.icosphere(subdivisions=3, radius=5.0).export(file)
    for change in (lambda: None, file.unlink):
        change()
        (limit,) = rig.controlled(rig.controller).regions
        assert limit.region.distance(point)[0] == pytest.approx(0.005, abs=1e-4)
        assert mesh_hashes(rig.keep_out) == before


def test_regions_with_the_same_keys_are_equal_if_their_files_had_the_same_content(tmp_path: Path) -> None:
    file = tmp_path / "ball.stl"
    trimesh.creation.icosphere(subdivisions=1, radius=10.0).export(file)
    region = MeshRegion(name="ball", file=str(file))
    first, same = read_regions([region]), read_regions([region])
    trimesh.creation.icosphere(subdivisions=1, radius=9.0).export(file)
    assert first == same != read_regions([region])


def test_a_path_that_is_not_a_regular_file_of_a_known_format_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.stl")
    (tmp_path / "mesh.glb").write_bytes(b"glTF")
    for name, message in (("pipe.stl", "not a file"), ("mesh.glb", "must end in one of stl, ply, obj")):
        with pytest.raises(ConfigError, match=message):
            keep_out([MeshRegion(name="region", file=str(tmp_path / name))])
