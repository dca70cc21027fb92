"""A live station and ROS 2 peers that use nothing of this project: states, motions, teleoperation, refusals, STOP."""

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager

import numpy as np
import pytest

from core.model.cosserat import ExactRod
from station.config.robots import load_robot
from tests.harness.crtk_peer import (
    EMPTY,
    FORWARD,
    INVERSE,
    JOINTS,
    LATCHED,
    OPERATING_STATE,
    POSE,
    STAMPED_STRING,
    STATE,
    STRING,
    TWIST,
    TYPES,
    Peer,
    header,
    pose,
    text,
    xyz,
)
from tests.harness.root import ROOT
from tests.harness.serving import Served, free_port, serving
from tests.harness.waiting import until

WIDE = {"silence": 2.0, "end": 30.0, "reach": 0.03}  # the station's clock is slow and the computer busy
COMMANDS = {
    **dict.fromkeys(("servo_cp", "servo_cr", "interpolate_cp", "move_cp", "move_cr"), POSE),
    **dict.fromkeys(("servo_jp", "servo_jr", "servo_jv", "interpolate_jp", "move_jp", "move_jr"), JOINTS),
    "servo_cv": TWIST, "hold": EMPTY,
}  # fmt: skip
OUTPUTS = {
    "operating_state": OPERATING_STATE, "error": STRING, "warning": STRING, "measured_js": JOINTS,
    "setpoint_cp": POSE, "goal_cp": POSE, "measured_cp": POSE,
}  # fmt: skip
UP = np.array([0.0, 0.0, 1.0])
FREE, BUSY = (lambda state: not state.is_busy), (lambda state: state.is_busy)


@pytest.fixture(scope="module")
def port() -> int:
    return free_port()


@pytest.fixture(scope="module")
def served(port: int) -> Iterator[Served]:
    with serving("--ros2", str(port), rate=1.0) as served:  # it homes, which a slow clock would make last minutes
        served.ready()
        yield served


def peer(port: int, node: str) -> Peer:
    made = Peer(port, node)
    for name, kind in OUTPUTS.items():
        made.subscribe(name, kind)
    for name, kind in COMMANDS.items():
        made.advertise(name, kind)
    made.advertise("state_command", STAMPED_STRING, LATCHED)
    made.wait("operating_state", lambda _: True)
    return made


@pytest.fixture
def leader(served: Served, port: int) -> Iterator[Peer]:
    served.ready()
    with closing(peer(port, "leader")) as made:
        yield made


@pytest.fixture
def other(served: Served, port: int) -> Iterator[Peer]:
    with closing(peer(port, "other")) as made:
        yield made


def command(who: Peer, word: str) -> None:
    who.send("state_command", text(word))


def become_operator(served: Served, who: Peer) -> None:
    command(who, "enable")
    until(lambda: served.status()["operator"]["name"] == who.node, who.all["error"])


def joints(values: object) -> object:
    return TYPES[JOINTS](header(), [], np.array(values), np.zeros(0), np.zeros(0))


def state(who: Peer, expected: str) -> None:
    who.wait("operating_state", lambda message: message.state == expected)


def start_targets(served: Served, headers: dict[str, str] | None = None) -> None:
    said: list[str] = []

    def started() -> bool:
        answer = served.rest.post("/api/gateway/target", json=WIDE, headers=headers)
        said[:] = [answer.text]
        return answer.status_code == 202

    until(started, said)  # once the force has decayed after the station's first motion
    served.wait_for(lambda status: status["phase"] == "moving")


@contextmanager
def staying_operator(served: Served) -> Iterator[None]:
    """Renew the lease of the test's client, as a page does, however long the block takes."""
    over = threading.Event()

    def renew() -> None:
        while not over.wait(1.0):
            served.status()

    renewal = threading.Thread(target=renew, name="operator")
    renewal.start()
    try:
        yield
    finally:
        over.set()
        renewal.join()


@pytest.fixture
def targets(served: Served, leader: Peer) -> Iterator[None]:
    """A run for external targets, whose operator is a person on the page."""
    start_targets(served)
    with staying_operator(served):
        yield


def setpoint(who: Peer) -> np.ndarray:
    who.newest.pop("setpoint_cp", None)
    return np.array(xyz(who.wait("setpoint_cp", lambda _: True).pose.position))


def test_a_client_that_is_operator_enables_moves_joints_and_homes_stages_that_are_not_homed(
    served: Served, leader: Peer
) -> None:
    become_operator(served, leader)
    now = leader.wait("measured_js", lambda _: True).position
    step = np.array([0.1 if name.endswith("rotation") else 0.0 for name in served.status()["joints"]])
    leader.newest.pop("operating_state")
    leader.send("move_jr", joints(step))
    leader.wait("operating_state", BUSY)
    leader.wait("operating_state", FREE)
    assert leader.wait("measured_js", lambda _: True).position == pytest.approx(now + step, abs=2e-3)
    leader.send("move_jp", joints(now))
    leader.wait("operating_state", BUSY)
    leader.wait("operating_state", FREE)
    leader.send("move_jp", joints(now + 100.0))
    assert "move_jp of 'leader' is refused" in leader.error("outside")
    velocity = TYPES[JOINTS](header(), [], np.zeros(0), 0.3 * step, np.zeros(0))
    deadline = time.monotonic() + 60.0
    while served.status()["phase"] != "jogging":
        assert time.monotonic() < deadline
        leader.send("servo_jv", velocity)
        time.sleep(0.02)
    served.wait_for(lambda status: status["state"] == "READY")  # a jog that is not renewed ends
    command(leader, "home")
    leader.wait("warning", lambda message: "homed already" in message.data)
    assert served.status()["state"] == "READY"
    served.rest.post("/api/operator", json={"take_over": True})
    served.post("/api/faults", {"faults": [{"kind": "restart", "device": "stages"}]})
    state(leader, "FAULT")
    served.post("/api/reset")
    served.wait_for(lambda status: status["state"] == "CONNECTED")
    served.rest.delete("/api/operator")
    command(leader, "enable")
    leader.wait("warning", lambda message: "send home" in message.data)
    command(leader, "home")
    leader.wait("operating_state", BUSY)
    leader.wait("operating_state", lambda message: message.is_homed and not message.is_busy, 400.0)
    assert served.status()["state"] == "READY"


def test_streamed_poses_of_the_joints_are_checked_followed_and_stopped(
    served: Served, leader: Peer, other: Peer
) -> None:
    become_operator(served, leader)

    def measured() -> np.ndarray:
        leader.newest.pop("measured_js", None)
        return np.array(leader.wait("measured_js", lambda _: True).position)

    def streamed(name: str, positions: object, ready: Callable[[], bool]) -> None:
        deadline = time.monotonic() + 60.0
        while not ready():
            assert time.monotonic() < deadline, (measured(), [each.data for each in leader.all["error"]])
            leader.send(name, joints(positions))

    start = measured()
    step = np.array([0.2 if name.endswith("rotation") else 0.004 for name in served.status()["joints"]])
    streamed("servo_jp", start + step, lambda: np.allclose(measured(), start + step, atol=1e-3))
    assert served.status()["phase"] == "jogging"
    served.wait_for(lambda status: status["state"] == "READY")  # a stream that ends leaves the joints at rest
    for _ in range(20):
        leader.send("servo_jr", joints(-0.05 * step))
        time.sleep(0.05)
    # Each step starts at the previous goal, not at the joints that are still on their path there.
    # After a pause of 0.3 s, on a busy computer, a step starts at the joints: so the end differs by a part of a step.
    streamed("servo_jr", 0.0 * step, lambda: bool((np.abs(measured() - start) < 0.1 * step).all()))
    served.wait_for(lambda status: status["state"] == "READY")
    leader.send("interpolate_jp", joints(start + step))
    assert until(lambda: np.allclose(measured(), start + step, atol=1e-3))
    served.wait_for(lambda status: status["state"] == "READY")
    for wrong, reason in ((start + 100.0, "outside"), (np.append(start, 0.0), "numbers for the joints")):
        leader.send("servo_jp", joints(wrong))
        assert "servo_jp of 'leader' is refused" in leader.error(reason)
    other.send("servo_jp", joints(start))
    other.error("'other' is not operator")
    assert measured() == pytest.approx(start + step, abs=1e-3)
    streamed("servo_jp", start, lambda: served.status()["state"] == "RUNNING")
    other.send("hold", TYPES[EMPTY]())
    state(leader, "PAUSED")
    at = served.rest_of_joints()  # the state is shown before the axes are at rest
    leader.send("servo_jp", joints(start))
    leader.error("'servo' is not possible while STOPPED")
    assert measured() == pytest.approx(at, abs=1e-4)


def test_services_answer_kinematics_and_the_state_while_the_robot_rests(served: Served, other: Peer) -> None:
    served.ready()
    state(other, "ENABLED")
    status = served.status()
    at = np.array(other.wait("measured_js", lambda _: True).position)
    tip = other.call("forward_kinematics", FORWARD, at, pose((0.0, 0.0, 0.0)).pose)
    assert (tip.result, tip.message) == (True, "")
    rod = ExactRod(load_robot("paper").robot()).solve(at, np.zeros(6))
    assert xyz(tip.cp.position) == pytest.approx(rod.tip, abs=3e-4)  # the model's integrator is 0.15 mm off
    goal = np.array(xyz(tip.cp.position)) + 0.005 * UP
    there = other.call("inverse_kinematics", INVERSE, pose(goal).pose, at)
    assert there.result, there.message
    assert np.abs(there.jp - at).max() > 1e-3
    again = other.call("forward_kinematics", FORWARD, there.jp, pose(goal).pose)
    assert xyz(again.cp.position) == pytest.approx(goal, abs=2e-5)
    for refused in (
        other.call("forward_kinematics", FORWARD, at + 100.0, tip.cp),
        other.call("forward_kinematics", FORWARD, at[:-1], tip.cp),
        other.call("inverse_kinematics", INVERSE, pose(goal + UP).pose, at),
        other.call("inverse_kinematics", INVERSE, pose((np.nan, 0.0, 0.0)).pose, at),
    ):
        assert not refused.result
        assert refused.message
    shown = other.call("operating_state", STATE).operating_state
    assert (shown.state, shown.is_homed, shown.is_busy) == ("ENABLED", True, False)
    assert served.status()["joints"] == pytest.approx(status["joints"], abs=1e-6)


def test_move_cp_is_busy_until_the_tip_has_arrived_and_needs_a_run_for_targets(served: Served, leader: Peer) -> None:
    become_operator(served, leader)
    start = setpoint(leader)
    leader.send("move_cp", pose(start + 0.002 * UP))
    leader.error("no run for external targets is active")
    assert served.status()["state"] == "READY"
    # The client itself is operator, so it starts the run under its own identity.
    start_targets(served, {"x-ctr-client": leader.id})
    start = setpoint(leader)
    goal = start + 0.002 * UP
    leader.newest.pop("operating_state")
    leader.send("move_cp", pose(goal))
    leader.wait("operating_state", BUSY)
    leader.wait("operating_state", FREE)
    assert setpoint(leader) == pytest.approx(goal, abs=2e-4), [each.data for each in leader.all["error"]]
    assert xyz(leader.wait("goal_cp", lambda message: message.header.stamp.sec > 0).pose.position) == pytest.approx(
        goal
    )
    leader.send("move_cr", pose(-0.001 * UP))
    leader.wait("operating_state", BUSY)
    leader.wait("operating_state", FREE)
    assert setpoint(leader) == pytest.approx(goal - 0.001 * UP, abs=2e-4)
    leader.all["operating_state"].clear()
    for _ in range(50):
        leader.send("servo_cr", pose(2e-5 * UP))
        time.sleep(0.02)
    assert until(lambda: setpoint(leader) == pytest.approx(goal, abs=2e-4))
    vector = TYPES["geometry_msgs/msg/Vector3"]
    upward = TYPES["geometry_msgs/msg/Twist"](vector(0.0, 0.0, 0.002), vector(0.0, 0.0, 0.0))
    while setpoint(leader)[2] < goal[2] + 1e-3:
        leader.send("servo_cv", TYPES[TWIST](header("world"), upward))
    leader.send("interpolate_cp", pose(start))
    assert until(lambda: setpoint(leader) == pytest.approx(start, abs=2e-4))
    assert not any(message.is_busy for message in leader.all["operating_state"])
    leader.send("move_cp", pose(start + 0.5 * UP))
    leader.error("beyond the reach")
    leader.send("move_cp", pose(start, frame="elsewhere"))
    leader.error("frame 'elsewhere' is unknown")
    command(leader, "pause")
    state(leader, "PAUSED")


@pytest.mark.usefixtures("targets")
def test_a_second_client_is_refused_but_its_hold_stops_the_robot(served: Served, leader: Peer, other: Peer) -> None:
    """The operator is a person on the page, so that the first client that sends a target controls the tip."""
    start = setpoint(leader)
    goal = start + 0.001 * UP
    command(leader, "enable")

    def followed() -> bool:
        leader.send("servo_cp", pose(goal))
        return bool(setpoint(leader)[2] > start[2] + 5e-4)

    until(followed)
    command(other, "enable")
    other.error("is operator" if served.status()["operator"] else "enable")
    other.send("move_cp", pose(start))
    assert "move_cp of 'other' is refused" in other.error("another program sends the targets")
    other.send("hold", TYPES[EMPTY]())
    state(leader, "PAUSED")
    status = served.wait_for(lambda now: now["cause"])  # it arrives shortly after the state
    assert (status["state"], status["cause"]) == ("STOPPED", "stopped by 'other' (ROS 2)")
    command(other, "resume")
    other.error("'other' is not operator")
    leader.send("servo_cp", pose(goal))
    leader.error("no run for external targets is active")


def test_every_state_is_shown_and_enable_never_clears_a_fault(served: Served, leader: Peer) -> None:
    become_operator(served, leader)
    command(leader, "pause")
    state(leader, "PAUSED")
    command(leader, "enable")
    leader.error("send resume")
    command(leader, "resume")
    state(leader, "ENABLED")
    command(leader, "unhome")
    leader.error("unhome is not available")
    command(leader, "dance")
    leader.error("send enable, disable")
    served.rest.post("/api/operator", json={"take_over": True})
    served.post("/api/faults", {"faults": [{"kind": "mute", "device": "stages"}]})
    state(leader, "FAULT")
    for word in ("enable", "resume"):
        command(leader, word)
        leader.error("a person must check the cause" if word == "enable" else "is not operator")
    served.rest.delete("/api/operator")
    leader.all["error"].clear()
    command(leader, "enable")
    leader.error("a person must check the cause")
    assert served.status()["state"] == "FAULT"
    assert not leader.newest["operating_state"].is_homed
    served.ready()
    state(leader, "ENABLED")
    become_operator(served, leader)
    command(leader, "disable")
    leader.wait("warning", lambda message: "no command that removes power" in message.data)
    served.wait_for(lambda status: status["state"] == "STOPPED" and status["operator"]["name"] is None)


def test_garbage_and_floods_move_nothing_and_the_station_continues(served: Served, leader: Peer, other: Peer) -> None:
    before = served.status()["joints"]
    rng = np.random.default_rng(1)
    for name in (*COMMANDS, "state_command"):
        if name != "hold":
            for size in (0, 3, 4, 40, 400, 100_000):
                other.send_bytes(name, rng.bytes(size))
                other.send_bytes(name, b"\0\1\0\0" + rng.bytes(size))
            other.send_bytes(name, b"", gid=bytes(16))
    assert other.error("is refused")
    ended = time.monotonic() + 3.0
    sent = 0
    while time.monotonic() < ended:
        other.send("servo_cp", pose((0.0, 0.0, 0.1)))
        sent += 1
    assert sent > 1000
    leader.newest.pop("measured_cp", None)
    leader.wait("measured_cp", lambda _: True)
    status = served.status()
    assert (status["state"], status["operator"]["name"]) == ("READY", None)
    assert status["joints"] == pytest.approx(before, abs=1e-6)


KILLED = """
import sys, time
from tests.live.web.gateway.test_crtk import peer, command, pose, setpoint, UP
who = peer(int(sys.argv[1]), "killed")
command(who, "enable")
goal = setpoint(who) + 0.01 * UP
who.send("move_cp", pose(goal))
print("sent", flush=True)
time.sleep(600)
"""


@pytest.mark.usefixtures("targets")
def test_the_motion_of_a_killed_client_ends(served: Served, leader: Peer, port: int) -> None:
    with subprocess.Popen((sys.executable, "-c", KILLED, str(port)), stdout=subprocess.PIPE, cwd=ROOT) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == b"sent\n"
        leader.wait("operating_state", BUSY)
        child.kill()
    leader.wait("operating_state", FREE)
    assert served.status()["state"] == "RUNNING"  # the operator still keeps the run
    # The next program controls the tip.
    start = setpoint(leader)
    leader.send("move_cp", pose(start))
    leader.wait("operating_state", lambda _: True)
    assert not [each.data for each in leader.all["error"]]
    served.post("/api/stop")
