"""Faults as an experiment file has them: what is refused, and whom a name means."""

from typing import Annotated

import pytest

from station.config.strict import ConfigError, Row, Strict, check
from station.lab.faults import KINDS, LabFault, Target, check_faults


class File(Strict):
    faults: Annotated[tuple[LabFault, ...], Row] = ()


def fault(**entries: object) -> LabFault:
    return check(LabFault, entries, "own.toml")


def test_a_fault_as_a_file_has_it():
    one = fault(kind="drop_bytes", device="stages", at=20.0, duration=5.0, value=0.02)
    assert (one.at, one.duration, one.value) == (20.0, 5.0, 0.02)
    assert fault(kind="mute", device="tracker").duration is None  # for ever


@pytest.mark.parametrize(
    ("entries", "told"),
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
def test_what_cannot_be_is_refused_by_key_and_bound(entries, told):
    with pytest.raises(ConfigError, match=told):
        fault(**entries)


def test_a_wrong_one_among_several_is_named_by_its_place():
    good = {"kind": "mute", "device": "tracker"}
    with pytest.raises(ConfigError, match=r"own.toml: faults.1 = .*'delay' needs a value"):
        check(File, {"faults": [good, {"kind": "delay", "device": "tracker"}]}, "own.toml")


@pytest.mark.parametrize(
    ("kind", "device", "target"),
    [
        ("mute", "stages", Target("stages", (0, 1, 2))),
        ("stall", "inner_rotation", Target("joint", (1,))),
        ("lose_tool", "tracker", Target("tracker", ())),
        ("saturate", "sensors", Target("sensor", (0, 1))),
        ("saturate", "outer", Target("sensor", (1,))),
    ],
)
def test_whom_a_name_means(paper, kind, device, target):
    assert fault(kind=kind, device=device).target(paper) == target


@pytest.mark.parametrize(
    ("kind", "device", "told"),
    [
        ("stall", "middle", r"device = 'middle': expected one of stages, tracker, sensors, outer_rotation, .*inner"),
        ("saturate", "stages", r"kind = 'saturate': to 'stages' can happen drop_bytes, flip_bits, .*restart"),
        ("stall", "stages", r"kind = 'stall': to 'stages' can happen"),
        ("lose_tool", "inner", r"kind = 'lose_tool': to 'inner' can happen drop_bytes, .*saturate"),
    ],
)
def test_what_cannot_happen_to_a_device_is_refused_with_what_can(paper, kind, device, told):
    with pytest.raises(ConfigError, match=rf"^faults\.0\.{told}"):
        check_faults([fault(kind=kind, device=device)], paper)


def test_a_name_of_a_joint_and_of_a_tube_means_the_one_to_which_it_can_happen(paper):
    joints = (paper.joints[0].model_copy(update={"name": "outer"}), *paper.joints[1:])
    robot = paper.model_copy(update={"joints": joints})

    assert fault(kind="stall", device="outer").target(robot).part == "joint"
    assert fault(kind="saturate", device="outer").target(robot).part == "sensor"
    with pytest.raises(ConfigError, match="a joint and a tube of that name"):
        fault(kind="mute", device="outer").target(robot)


def test_every_kind_can_happen_to_something():
    assert all(kind.parts for kind in KINDS.values())
