"""Request of a run as one frozen value, for the control process, the lab and the recording."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from station.config.loads import Load, NoLoad
from station.control.task import MotionTask
from station.lab.faults import LabFault

_NO_LOAD = NoLoad()


@dataclass(frozen=True)
class StartRequest:
    """Task of a run, load and faults of the virtual lab during the run, and metadata of the recording."""

    task: MotionTask
    title: str  #: human-readable name of the run
    load: Load | None = _NO_LOAD  #: load at the tip of the virtual lab's robot during the motion; None: no change
    faults: tuple[LabFault, ...] = ()  #: faults of the virtual lab's devices; their times count from the motion's start
    counted_from: float = 0.0  #: errors of the tip before this time of the motion are not counted [s]
    warnings: tuple[str, ...] = ()  #: warnings for the operator, shown after acceptance
    about: Mapping[str, Any] = field(default_factory=dict[str, Any])  #: further metadata of the recording
    recorded: bool = True  #: whether the run is recorded


@dataclass(frozen=True)
class RunRequest:
    """Start request with the number and the id of its run."""

    number: int  #: number of the run, from 1
    id: str  #: id of the run, also the name of its recording
    start: StartRequest
