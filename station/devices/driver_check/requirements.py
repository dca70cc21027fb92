"""Requirements of the control loop on a driver; `check-driver` checks them, and prints them with `--requirements`."""

from collections.abc import Callable, Iterator
from enum import Enum
from typing import NamedTuple

from core.errors import CtrError
from station.devices.guard import DriverError
from station.devices.interfaces import DeviceKind

CONNECT_S, HOME_S = 60.0, 600.0  #: longest time to connect and to home [s]
MAX_TYPICAL_S = 0.001  #: largest median of the time that all calls of one tick take together [s]: half of a tick
MAX_CALL_S = 0.25  #: longest call [s]: a quarter of the time after which the station kills the control process
MAX_SPEED_ERROR = 0.05  #: largest relative error of a speed
MAX_STOP_S = 0.5  #: largest time from a stop to rest, in addition to the braking time [s]
MAX_EMERGENCY_STOP_S = 2.0  #: longest emergency stop [s]
FROZEN_S = 0.5  #: time after which the position of a moving axis must have changed [s]
MAX_AGE_S = 1.0  #: largest age of the newest frame or sample [s]
#: Largest distance of a tip from the world's origin [m]; a driver that reports millimetres exceeds it at 10 mm.
MAX_DISTANCE_M = 10.0


class Requirement(NamedTuple):
    """A requirement on drivers: one row of the table that `check-driver --requirements` prints."""

    name: str
    must: str
    why: str  #: why the control loop needs it
    kinds: tuple[DeviceKind, ...] = ("stages",)
    moves: bool = False  #: whether the check of this requirement moves the stages


_ALL: tuple[DeviceKind, ...] = ("stages", "tracker", "sensors")
_SAMPLED: tuple[DeviceKind, ...] = ("tracker", "sensors")


class Must(Enum):
    """The requirements, in the order of the printed table."""

    NO_EXCEPTIONS = Requirement(
        "exceptions",
        "after the opening no method raises; only `home` may refuse with a `CtrError`",
        "an exception ends the control process, and the station process must stop the stages",
        _ALL,
    )
    RESULTS = Requirement(
        "results",
        "each method returns the type and shape that `interfaces.py` states; velocities and times are finite",
        "the loop computes with the results, and ends the control process at a wrong one",
        _ALL,
    )
    DURATION = Requirement(
        "duration",
        f"`poll`, `command`, `stop` and `trouble` do not wait for the device: together they usually take at most"
        f" {1e3 * MAX_TYPICAL_S:g} ms a tick, and no call takes {MAX_CALL_S:g} s",
        "the loop has 2 ms for all devices and the control law, and STOP waits for the call in progress",
        _ALL,
    )
    CONNECTION = Requirement(
        "connection",
        f"`connect` leads to CONNECTED within {CONNECT_S:g} s, and the device remains connected",
        "the loop uses only connected devices",
        _ALL,
    )
    UNKNOWN = Requirement(
        "unknown positions",
        "before `connect` all positions are NaN, and `ready` is False",
        "the loop must not control the robot with positions that were never measured",
    )
    REST = Requirement(
        "rest",
        "without a command no axis moves, also after `connect`, and `sent` is zero",
        "the operator does not expect a motion before the first command",
    )
    NOT_READY = Requirement(
        "commands before ready",
        "`command` has no effect unless `ready`",
        "the limits of an axis are known only after homing",
        moves=True,
    )
    HOMING = Requirement(
        "homing",
        f"`home` leads to `ready` within {HOME_S:g} s, unless the stages are ready after `connect`",
        "motions need the position of every axis",
        moves=True,
    )
    FINITE = Requirement(
        "finite positions", "positions that were known remain finite", "a position that is not finite ends every motion"
    )
    FRESH = Requirement(
        "fresh positions",
        f"the position of a moving axis changes within {FROZEN_S:g} s, and does not jump",
        "with an old position the loop moves the robot blindly",
        moves=True,
    )
    SPEED = Requirement(
        "speed",
        f"`sent` is the commanded velocity, and the axes move with it, both within {100.0 * MAX_SPEED_ERROR:g} %",
        "the controller predicts the motion of the axes from `sent`",
        moves=True,
    )
    SPEED_LIMIT = Requirement(
        "speed limit",
        "a command beyond the `speed` of a joint in the robot file is limited to it, in `sent` and in the motion",
        "it protects the robot from a faulty custom control loop; braking distances are computed for this speed",
        moves=True,
    )
    STOP = Requirement(
        "stop",
        f"after `stop` all axes rest within their braking time and {MAX_STOP_S:g} s, and `sent` is zero",
        "STOP and every fault call `stop`",
        moves=True,
    )
    VELOCITY_NAN = Requirement(
        "velocity nan",
        "a command with a velocity that is not finite stops all axes and is not sent",
        "what a device does with such a velocity is unknown",
        moves=True,
    )
    EMERGENCY_STOP = Requirement(
        "emergency stop",
        f"the driver has the function `emergency_stop`; after it has confirmed, within {MAX_EMERGENCY_STOP_S:g} s, a"
        " new connection finds all axes at rest",
        "after a crash of the control process only this function stops the stages",
        moves=True,
    )
    SAMPLES = Requirement(
        "samples",
        f"a new frame, or a new usable sample, arrives at least every {MAX_AGE_S:g} s",
        "the loop cannot notice that a device repeats an old measurement",
        _SAMPLED,
    )
    TIMES = Requirement(
        "times",
        f"the time of a measurement increases at the rate of the clock, is not in the future, and is at most"
        f" {MAX_AGE_S:g} s old",
        "the controller compares each measurement with the model at the time of the measurement",
        _SAMPLED,
    )
    FRAME_NUMBERS = Requirement(
        "frame numbers",
        "`frame` increases, and a frame is returned once",
        "the observer would count a repeated frame twice",
        ("tracker",),
    )
    POSITIONS = Requirement(
        "positions",
        f"positions are finite and at most {MAX_DISTANCE_M:g} m from the world's origin; a direction has length 1",
        "a larger distance is probably in millimetres instead of metres",
        ("tracker",),
    )
    WRENCHES = Requirement(
        "wrenches", "forces and moments are finite", "a force that is not finite ends a motion", ("sensors",)
    )


class Finding(NamedTuple):
    """Result of one check."""

    requirement: Must
    good: bool | None  #: None: not checked
    text: str

    @property
    def subject(self) -> str:
        """Name of the requirement."""
        return self.requirement.value.name


class Broken(CtrError):
    """A driver breaks a requirement so that the following checks are impossible; the text states what happened."""

    def __init__(self, requirement: Must, text: str) -> None:
        super().__init__(text)
        self.requirement = requirement


def requirements_table() -> str:
    """Return the requirements as a table in Markdown."""
    rows = ["| requirement | of | a driver must | reason |", "|---|---|---|---|"]
    for each in (must.value for must in Must):
        of = "all" if each.kinds == _ALL else ", ".join(each.kinds)
        rows.append(f"| {each.name} | {of} | {each.must} | {each.why} |")
    return "\n".join(rows) + "\n"


def one_finding_each(
    kind: DeviceKind, checks: Iterator[Finding], end: Callable[[], None], moves: bool = True
) -> Iterator[Finding]:
    """Yield one finding for each requirement of a kind of device, also if a check fails; `end` closes the device."""
    left = [must for must in Must if kind in must.value.kinds]
    broken: Broken | None = None
    try:
        for finding in checks:
            left.remove(finding.requirement)
            yield finding
    except DriverError as error:
        broken = Broken(Must.RESULTS, str(error))
    except Broken as error:
        broken = error
    finally:
        try:
            end()
        except (Broken, DriverError) as error:
            broken = broken or Broken(getattr(error, "requirement", Must.RESULTS), str(error))
    if broken is not None and broken.requirement not in left:
        left.append(broken.requirement)  # an earlier check has passed, but now the driver breaks it
    for must in left:
        if broken is not None and must is broken.requirement:
            yield Finding(must, False, str(broken))
        elif broken is None and must in (Must.NO_EXCEPTIONS, Must.RESULTS):
            yield Finding(must, True, "no violation until the end")
        else:
            needs = must.value.moves and not moves
            yield Finding(must, None, "not checked; it needs --move" if needs else "not checked: the check ended early")
