"""The true shape that the virtual lab gives to simulated cameras, and its endpoint."""

import math
import socket
import struct

import numpy as np
import pytest

from core.model.cosserat import ExactRod
from core.model.solution import pure_force
from core.robot.robot import Robot
from station.config.loads import ConstantLoad
from station.config.robots import RobotFile
from station.lab.config import PlantConfig, load_lab
from station.lab.endpoints import HOST, Readable
from station.lab.frictional_plant import true_plant
from station.lab.lab_server import LabServer
from station.lab.plant import TubeShape
from station.lab.shape_server import ShapeClient, ShapeServer, TimedShape, pack, unpack

JOINTS = np.array([0.2, 1.3, -0.09])
FORCE = np.array([0.2, -0.1, 0.05])


@pytest.mark.parametrize("contact", [np.inf, 0.1])
@pytest.mark.parametrize("rod", ["smooth", "rough"])
def test_shape_ends_at_the_true_tip_and_its_tangents_follow_its_positions(
    paper_robot: Robot, rod: str, contact: float
) -> None:
    config = PlantConfig() if rod == "smooth" else PlantConfig(
        rod="rough", friction=0.3, clearance=1e-4, friction_force=0.0, friction_moment=0.0
    )  # fmt: skip
    plant = true_plant(paper_robot, config, np.random.default_rng(1), JOINTS)
    for part in np.linspace(0.0, 1.0, 20):
        truth = plant.advance(JOINTS + part * np.array([0.1, 0.2, 0.002]), part * FORCE, contact).truth
    shape = plant.shape()

    arc, points, tangents = shape.line[:, 0], shape.line[:, 1:4], shape.line[:, 4:]
    assert np.abs(points[-1] - truth.tip).max() < 1e-6
    assert truth.direction is not None
    assert np.abs(tangents[-1] - truth.direction).max() < 1e-4
    assert np.abs(points[0]).max() == 0.0
    assert shape.ends.max() == pytest.approx(arc[-1])
    assert (shape.force == FORCE).all()
    assert shape.contact == contact
    chords, mean = np.diff(points, axis=0), 0.5 * (tangents[1:] + tangents[:-1])
    step = np.diff(arc)[:, None]
    assert np.abs(chords - step * mean).max() < 2e-4


def test_smooth_shape_equals_that_of_the_exact_rod_with_small_steps(paper_robot: Robot) -> None:
    ideal = PlantConfig(tubes={}, poisson_ratio="described", play={}, step=0.002)
    plant = true_plant(paper_robot, ideal, np.random.default_rng(0), JOINTS)
    plant.advance(JOINTS, FORCE)

    rod = ExactRod(paper_robot, step=0.0005).solve(JOINTS, pure_force(FORCE))
    assert np.abs(plant.shape().line[-1, 1:4] - rod.tip).max() < 1e-7


def test_packed_shape_is_unpacked_without_loss_and_damaged_datagrams_are_ignored() -> None:
    shape = TubeShape(np.arange(21.0).reshape(3, 7), np.array([2.0, 1.0]), np.array([0.1, 0.2, 0.3]), np.inf)
    datagram = pack(TimedShape(12.5, shape))

    found = unpack(datagram)
    assert found is not None
    assert found.time == 12.5
    assert all(np.array_equal(a, b) for a, b in zip(found.shape, shape, strict=True))
    no_number = datagram[:8] + struct.pack("<d", math.nan) + datagram[16:]
    for damaged in (b"", datagram[:-1], datagram[:48], datagram[:-8], no_number):
        assert unpack(damaged) is None


def test_client_receives_the_shape_of_the_polled_server_only() -> None:
    server, client = ShapeServer(Readable()), ShapeClient()
    shape = TubeShape(np.zeros((2, 7)), np.ones(2), np.zeros(3), np.inf)
    try:
        assert client.request(server.port) is None  # the server was not polled
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as foreign:
            foreign.sendto(b"anything else", (HOST, server.port))
        server.poll(lambda: shape, 7.0)  # the answer comes too late for the request above
        client._socket.sendto(b"shape", (HOST, server.port))
        server.poll(lambda: shape, 8.0)
        received = [unpack(client._socket.recv(65536)) for _ in range(2)]
        assert [one.time for one in received if one is not None] == [7.0, 8.0]
    finally:
        client.close()
        server.close()


def test_lab_has_a_shape_endpoint_only_on_request(paper: RobotFile) -> None:
    config = load_lab("gentle", paper)
    with LabServer(paper, config, 0, JOINTS) as lab:
        assert lab.shape is None
    with LabServer(paper, config, 0, JOINTS, homed=True, shape=True) as lab:
        lab.lab.apply_load(ConstantLoad(magnitude=0.2), 0.0)
        lab.lab.advance(0.01)
        assert lab.shape is not None
        assert np.abs(lab.lab.shape().line[-1, 1:4] - lab.lab.truth.tip).max() < 1e-6
