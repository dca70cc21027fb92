"""Whether a case of an experiment is meant for this station: its robot, its lab, its calibration.

Another robot is refused. Another lab or calibration is told before the start and in the recording: the case is
carried out on what is there.
"""

from pathlib import Path

from station.experiments.experiment import Case
from station.service.bench import Bench


def refusal(case: Case, bench: Bench) -> str:
    """Why this station cannot carry it out; empty when it can."""
    if case.robot != bench.robot:
        name = bench.robot.name
        other = f"this station has '{name}'" if case.robot.name != name else "this station's robot of that name differs"
        return f"for robot '{case.robot.name}'; {other}: start one with robot = \"{case.file.robot}\" in its file"
    if case.orders.follow is not None and (missing := no_target(bench)):
        return missing
    if case.file.faults and bench.devices is not None:
        return "its faults are of the virtual lab's devices; this station has devices of its own"
    return ""


def no_target(bench: Bench) -> str:
    """Why nothing can ever be followed here; empty when a target may be seen."""
    if bench.may_see_target:
        return ""
    how = "`serve --lab breathing` has one" if bench.devices is None else "name its coil in devices.tracker.target"
    return f"it follows a target, and this station's tracker has no second coil for one: {how}"


def otherwise(case: Case, bench: Bench) -> tuple[str, ...]:
    """What is not as the case has it, though it can be carried out."""
    file, found = case.file, []
    if "lab" in file.model_fields_set and (bench.devices is not None or case.lab != bench.lab):
        found.append(
            f"written for lab '{file.lab}', carried out on this station's own: {bench.title};"
            f" `ctr-station run` and `serve --lab {file.lab}` have that lab"
        )
    own = None if bench.calibration is None else bench.calibration.folder
    if file.calibration and (own is None or own.resolve() != Path(file.calibration).resolve()):
        found.append(
            f"written with the calibration {file.calibration}, carried out with this station's"
            f" ({'none' if own is None else own}); `serve --calibration {file.calibration}` has that"
        )
    return tuple(found)
