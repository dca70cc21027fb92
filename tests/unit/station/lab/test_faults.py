"""Faults in an experiment file: invalid ones are refused, and device names select the affected devices."""

from typing import Annotated

import pytest

from station.config.strict import ConfigError, Row, Strict, check
from station.lab.faults import FAULT_KINDS, FaultTarget, LabFault, check_faults


class File(Strict):
    faults: Annotated[tuple[LabFault, ...], Row] = ()


def fault(**entries: object) -> LabFault:
    return check(LabFault, entries, "own.toml")


def test_fault_of_a_simulated_device_is_read_from_a_file():
    one = fault(kind="drop_bytes", device="stages", at=20.0, duration=5.0, value=0.02)
    assert (one.at, one.duration, one.value) == (20.0, 5.0, 0.02)
    assert fault(kind="mute", device="tracker").duration is None  # the fault is permanent


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"kind": "explode", "device": "stages"}, r"kind = 'explode'.*'drop_bytes'"),
        ({"kind": "mute"}, "'device' is missing"),
        ({"kind": "mute", "device": "stages", "at": -1.0}, "at = -1.0"),
        ({"kind": "mute", "device": "stages", "at": float("nan")}, "at = nan"),
        ({"kind": "mute", "device": "stages", "duration": 0.0}, "duration = 0.0"),
        ({"kind": "mute", "device": "stages", "for": 1.0}, "unknown key 'for'"),
        ({"kind": "mute", "device": "stages", "value": 1.0}, "'mute' has no value"),
        ({"kind": "drop_bytes", "device": "stages"}, r"'drop_bytes' needs a value above 0, at most 1 \(probability\)"),
        ({"kind": "flip_bits", "device": "stages", "value": 1.5}, r"at most 1 \(probability\)"),
        ({"kind": "jump", "device": "tracker", "value": 2.0}, r"at most 0.5 \(m\)"),
        ({"kind": "delay", "device": "tracker", "value": 100.0}, r"at most 60 \(s\)"),
        ({"kind": "restart", "device": "tracker", "duration": 1.0}, "'restart' happens at once"),
    ],
)
def test_invalid_fault_is_refused_by_key_and_bound(entries, message):
    with pytest.raises(ConfigError, match=message):
        fault(**entries)


def test_invalid_fault_among_several_is_named_by_its_index():
    good = {"kind": "mute", "device": "tracker"}
    with pytest.raises(ConfigError, match=r"own.toml: faults.1 = .*'delay' needs a value"):
        check(File, {"faults": [good, {"kind": "delay", "device": "tracker"}]}, "own.toml")


@pytest.mark.parametrize(
    ("kind", "device", "target"),
    [
        ("mute", "stages", FaultTarget("stages", (0, 1, 2))),
        ("stall", "inner_rotation", FaultTarget("joint", (1,))),
        ("lose_tool", "tracker", FaultTarget("tracker", ())),
        ("saturate", "sensors", FaultTarget("sensor", (0, 1))),
        ("saturate", "outer", FaultTarget("sensor", (1,))),
    ],
)
def test_device_name_of_a_fault_selects_the_affected_devices(paper, kind, device, target):
    assert fault(kind=kind, device=device).target(paper) == target


@pytest.mark.parametrize(
    ("kind", "device", "message"),
    [
        ("stall", "middle", r"device = 'middle': expected one of stages, tracker, sensors, outer_rotation, .*inner"),
        ("saturate", "stages", r"kind = 'saturate': 'stages' can have only the faults drop_bytes, .*restart"),
        ("stall", "stages", r"kind = 'stall': 'stages' can have only the faults"),
        ("lose_tool", "inner", r"kind = 'lose_tool': 'inner' can have only the faults drop_bytes, .*saturate"),
    ],
)
def test_impossible_fault_of_a_device_is_refused_with_the_possible_ones(paper, kind, device, message):
    with pytest.raises(ConfigError, match=rf"^faults\.0\.{message}"):
        check_faults([fault(kind=kind, device=device)], paper)


def test_fault_on_a_name_of_both_joint_and_tube_affects_the_possible_device(paper):
    joints = (paper.joints[0].model_copy(update={"name": "outer"}), *paper.joints[1:])
    robot = paper.model_copy(update={"joints": joints})

    assert fault(kind="stall", device="outer").target(robot).part == "joint"
    assert fault(kind="saturate", device="outer").target(robot).part == "sensor"
    with pytest.raises(ConfigError, match="is a joint and a tube of robot"):
        fault(kind="mute", device="outer").target(robot)


def test_every_kind_of_fault_has_a_target():
    assert all(kind.parts for kind in FAULT_KINDS.values())
