"""A start as one frozen value, on its way from whoever asks for it to the control process and the lab."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from station.control.task import Task
from station.lab.faults import LabFault
from station.lab.loads import Load, NoLoad

_NONE = NoLoad()


@dataclass(frozen=True)
class Start:
    """What is to be done, what the virtual lab does meanwhile, and what the recording says about it."""

    task: Task
    title: str
    load: Load | None = _NONE  #: at the virtual lab's tip during the motion; None: what hangs there is left alone
    faults: tuple[LabFault, ...] = ()  #: of the virtual lab's devices, their times counted from the motion's start
    counted_from: float = 0.0  #: the tip's errors count from so long after the motion's start [s]
    warnings: tuple[str, ...] = ()  #: what a person should know about it, once it has been accepted
    about: Mapping[str, Any] = field(default_factory=dict[str, Any])  #: what its recording says besides
    recorded: bool = True


@dataclass(frozen=True)
class Run:
    """A start that has been numbered."""

    number: int
    id: str  #: of its recording, too
    start: Start
