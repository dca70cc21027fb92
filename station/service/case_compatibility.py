"""Check whether an experiment's case fits the robot, lab and calibration of this station.

A case for another robot is refused. A case for another lab or calibration runs on the lab and calibration of this
station; a warning before the start, and in the recording, reports the deviation.
"""

from pathlib import Path

from station.experiments.experiment import Case
from station.service.rig import Rig


def incompatibility(case: Case, bench: Rig) -> str:
    """Return why this station cannot run a case; empty when it can run it."""
    if case.robot != bench.robot:
        name = bench.robot.name
        other = f"this station has '{name}'" if case.robot.name != name else "this station's robot of that name differs"
        return f"for robot '{case.robot.name}'; {other}: start one with robot = \"{case.file.robot}\" in its file"
    if case.orders.follow is not None and (missing := missing_target(bench)):
        return missing
    if case.file.faults and bench.devices is not None:
        return "its faults are for the virtual lab's devices; this station has real devices"
    return ""


def missing_target(bench: Rig) -> str:
    """Return why this station cannot follow a target; empty when it can follow one."""
    if bench.can_track_target:
        return ""
    how = "`serve --lab breathing` has one" if bench.devices is None else "name its coil in devices.tracker.target"
    return f"it follows a target, and this station's tracker has no second coil for one: {how}"


def deviations_from_case(case: Case, bench: Rig) -> tuple[str, ...]:
    """Return the differences between a case and this station that do not prevent its run."""
    file, found = case.file, []
    if "lab" in file.model_fields_set and (bench.devices is not None or case.lab != bench.lab):
        found.append(
            f"written for lab '{file.lab}', runs on this station instead: {bench.title};"
            f" `ctr-station run` and `serve --lab {file.lab}` use that lab"
        )
    own = None if bench.calibration is None else bench.calibration.folder
    if file.calibration and (own is None or own.resolve() != Path(file.calibration).resolve()):
        found.append(
            f"written with the calibration {file.calibration}, runs with this station's"
            f" ({'none' if own is None else own}); `serve --calibration {file.calibration}` uses that calibration"
        )
    return tuple(found)
