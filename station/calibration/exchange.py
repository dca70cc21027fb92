"""Tubes were exchanged: what of an earlier calibration still holds, and what must be done again, in order."""

from station.config.robots import RobotFile
from station.config.strict import Strict


class Todo(Strict):
    """One line of the checklist."""

    procedure: str
    """to be carried out; empty: something that a person does"""
    text: str


def checklist(before: RobotFile, now: RobotFile) -> list[Todo]:
    """What has to be done before the first run with `now` on a bench that was calibrated with `before`."""
    todo = [
        ("", "Switch the stages' power off before you reach in; fit the new tubes, innermost first."),
        ("", "Check that each tube turns and slides freely in the next, and that its zero mark points along +x."),
        ("", "Home the stages with nothing near the tubes."),
    ]
    stages = [(joint.name, joint.motion, joint.microstep) for joint in before.joints]
    if stages != [(joint.name, joint.motion, joint.microstep) for joint in now.joints]:
        todo.append(("axes", "The stages are others: find out which way each axis runs."))
        todo.append(("latency", "The stages are others: measure the latency anew."))
    elif [tube.name for tube in before.tubes] != [tube.name for tube in now.tubes]:
        todo.append(("axes", "The tubes are others: make sure that the right stage moves the right tube."))
    if len(before.tubes) != len(now.tubes):
        todo.append(("force", "The number of sensors has changed: calibrate all of them."))
    if before.tubes != now.tubes:
        todo.append(("tubes", "EI, curvature, nu, lengths, zeros, coil and frames belong to the old tubes."))
    else:
        todo.append(("tracker", "The coil was taken off and put on again: find where it is."))
    return [Todo(procedure=procedure, text=text) for procedure, text in todo]
