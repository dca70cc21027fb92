"""Checklist after an exchange of tubes: the procedures that must be repeated, in order."""

from station.config.robots import RobotFile
from station.config.strict import Strict


class CheckItem(Strict):
    """One line of the checklist."""

    procedure: str
    """name of the procedure to run; empty: a task for the operator"""
    text: str


def connection_checklist(before: RobotFile, now: RobotFile) -> list[CheckItem]:
    """Return the tasks before the first run with `now` on a bench that was calibrated with `before`."""
    todo = [
        ("", "Switch the stages' power off before you reach in; fit the new tubes, innermost first."),
        ("", "Check that each tube turns and slides freely in the next, and that its zero mark points along +x."),
        ("", "Home the stages with nothing near the tubes."),
    ]
    stages = [(joint.name, joint.motion, joint.microstep) for joint in before.joints]
    if stages != [(joint.name, joint.motion, joint.microstep) for joint in now.joints]:
        todo.append(("axes", "The stages have changed: find the direction of each axis."))
        todo.append(("latency", "The stages have changed: measure the latency again."))
    elif [tube.name for tube in before.tubes] != [tube.name for tube in now.tubes]:
        todo.append(("axes", "The tubes have changed: check that each stage moves the correct tube."))
    if len(before.tubes) != len(now.tubes):
        todo.append(("force", "The number of sensors has changed: calibrate all of them."))
    if before.tubes != now.tubes:
        todo.append(("tubes", "EI, curvature, nu, lengths, zeros, coil and frames belong to the old tubes."))
    else:
        todo.append(("tracker", "The coil was removed and mounted again: find its position."))
    return [CheckItem(procedure=procedure, text=text) for procedure, text in todo]
