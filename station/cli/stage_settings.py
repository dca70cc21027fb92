"""Settings of the stages of a station file, as read and set while their driver connects, for `ctr-station doctor`."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from typing import Any

from core.errors import CtrError
from station.cli.machine import MachineFinding
from station.control.clock import REAL_TIME_CLOCK
from station.devices.interfaces import Condition, Stages
from station.devices.registry import plan
from station.service.station_file import Rig

CONNECT_S, TICK_S = 60.0, 0.002  #: longest time of a connection, and time between two polls [s]


def settings_findings(rig: Rig) -> Iterator[MachineFinding]:
    """Connect the stages of a rig without moving them, and return each setting with its values before and after."""
    try:
        stages, now, wait = _opened(rig)
    except CtrError as error:
        yield MachineFinding("stages", False, f"cannot be opened, so their settings are unknown: {error}")
        return
    with closing(stages):
        start = now()
        stages.connect(start)
        while (connecting := stages.condition is Condition.CONNECTING) and now() - start < CONNECT_S:
            stages.poll(now())
            wait()
        details, cause = stages.details(), str(stages.trouble(now()) or "")
    for text, joints in _by_text(details).items():
        yield MachineFinding("setting", True, f"{text} ({joints})")
    if connecting:
        cause = f"not connected after {CONNECT_S:g} s{cause and ': '}{cause}"
    if cause:
        yield MachineFinding("stages", False, cause)


def _by_text(details: Mapping[str, Any]) -> dict[str, str]:
    """Return the joints of each setting, by its text: a setting of a whole device has the same text for all joints."""
    joints: dict[str, list[str]] = {}
    for joint, one in details.items():
        for name, text in one.get("settings", {}).items() if isinstance(one, Mapping) else ():
            joints.setdefault(f"{name} = {text}", []).append(joint)
    return {text: ", ".join(names) for text, names in joints.items()}


def _opened(rig: Rig) -> tuple[Stages, Callable[[], float], Callable[[], None]]:
    """Return the stages of a rig, their time [s], and a function that waits for the next poll.

    Raises:
        CtrError: they cannot be opened.
    """
    if rig.devices is not None:
        stages = plan(rig.devices, rig.robot)["stages"]()
        return stages, REAL_TIME_CLOCK.now, lambda: REAL_TIME_CLOCK.sleep(TICK_S)
    from station.lab.virtual_bench import stages_alone

    stages, advance = stages_alone(rig.robot, rig.lab, rig.seed, rig.park)
    time = [0.0]

    def wait() -> None:
        advance(time[0], time[0] + TICK_S)
        time[0] += TICK_S

    return stages, lambda: time[0], wait
