"""Configuration of the controller: model, limits, estimators, feedback of the loops, and controlled coordinates."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from core.contract import name_of, reset_state
from core.control.controllers import FeedbackOptions, Strategy, Task, TaskInputs, custom_rows
from core.control.deflection_force import TUBE_ERROR
from core.control.estimation import NO_LOAD, Estimator
from core.control.null_space import Kinks, NullSpaceObjective, kinks_of
from core.control.sensors import Corrections
from core.control.shape_correction import FORCE_ERROR_N, UNKNOWN_FORCE_N, Cause, error_causes
from core.control.stiffness import STAGES_LAG_S, TipStiffness
from core.control.tip_direction import POSITION_ONLY, TaskSelection
from core.errors import DescriptionError
from core.model.statics import Statics
from core.robot.keep_out import KeepOut
from core.robot.limits import Limits
from core.robot.robot import Array


@dataclass(frozen=True)
class Controller:
    """Configuration of the controller; it does not change between ticks."""

    statics: Statics
    strategy: Strategy
    limits: Limits
    estimator: Estimator
    #: True: the outer loop uses the observed tip, predicted for the time when its command takes effect. False: it uses
    #: the latest tracker frame, as in the paper.
    observes: bool = False
    #: True: the inner loop Type I takes the deflection's rate from C, J and the filtered force. False: it uses the
    #: filtered numerical derivative, as in the paper.
    exact_rate: bool = False
    #: True: the inner loop Type II takes the tip's velocity from differentiated tracker frames, as in the paper. False:
    #: it uses the tip observer.
    differentiates: bool = False
    #: Corrections from a calibration; None: the coil is at the tip and the sensors are aligned with their tubes.
    corrections: Corrections | None = None
    #: Coordinates of the tip that are controlled: position, direction or both.
    aim: TaskSelection = POSITION_ONLY
    #: Tasks in addition to position and direction, for robots with redundant joints.
    tasks: tuple[Task, ...] = ()
    #: Objective that moves redundant joints; None: the preferred joint velocity is zero.
    null_space: NullSpaceObjective | None = None
    #: True: the tip's direction is estimated even if it is not controlled; a calibration needs this estimate.
    watches: bool = False
    #: False: the bench has no tracker; the controller uses the model's tip instead of a measured tip.
    tracked: bool = True
    #: False: the bench has no force sensors; the force from the deflection replaces the measured force.
    senses: bool = True
    #: Standard deviation of the model's deflection relative to the deflection, for the force from the deflection.
    tube_error: float = TUBE_ERROR
    #: Desired stiffness of the tip; None: as stiff as the joints allow.
    stiffness: TipStiffness | None = None

    def __post_init__(self) -> None:
        n = len(self.limits.joints)
        if self.aim.lever > 0.0 and self.strategy.laws is None:
            raise DescriptionError("custom loops control position only; use a built-in strategy to control direction")
        if self.tasks and self.strategy.laws is None:
            raise DescriptionError("custom loops control position only; use a built-in strategy with further tasks")
        laws = self.strategy.laws
        if self.stiffness is not None and not (laws is not None and laws[0] == laws[1] > 0.0):
            raise DescriptionError(
                "stiffness: the loops must control the tip's position; use strategy 'dual_layer' with k1 = k2 above 0"
            )
        if self.aim.lever > 0.0 and self.aim.rows > n:
            raise DescriptionError(f"task: {self.aim.rows} coordinates need at least as many joints; the robot has {n}")

    @property
    def period(self) -> float:
        """Time between ticks [s]."""
        return self.estimator.filter.period

    @cached_property
    def no_zeros(self) -> Array:
        """Sensor zeros (s, 6) of a controller that does not estimate their drift since the tare: all 0 [N, N m]."""
        return np.zeros((len(self.statics.robot.sensor_names), 6))

    @cached_property
    def feedback(self) -> FeedbackOptions:
        """Measurements and estimates that the loops use as feedback."""
        lead_time = self.estimator.actuation.lead_time if self.observes else 0.0
        return FeedbackOptions(lead_time, self.observes, self.exact_rate)

    @cached_property
    def force_delay(self) -> float:
        """Time from a change of the force at the tip to the joints' response [s].

        Without force sensors the observer detects the force, so the observer's time constant is added.
        """
        observing = 0.0 if self.senses else 1.0 / (2.0 * math.pi * self.estimator.observer.bandwidth)
        return self.estimator.actuation.lead_time + STAGES_LAG_S + observing

    @cached_property
    def regions(self) -> tuple[KeepOut, ...]:
        """Limits of this controller that keep the tubes out of regions."""
        return tuple(limit for limit in self.limits.others if isinstance(limit, KeepOut))

    @cached_property
    def error_causes(self) -> tuple[Cause, ...]:
        """Causes of the model's error at the tip."""
        return error_causes(self.statics, self.tube_error, FORCE_ERROR_N if self.senses else UNKNOWN_FORCE_N)

    @cached_property
    def kinks(self) -> Kinks:
        """Kinks (joint positions where the Jacobian jumps) that the null-space objective resists.

        With a single redundant joint the result is empty. Such a joint would have to move at top speed to keep the
        other joints from crossing a kink.
        """
        kinks = kinks_of(self.statics.robot)
        return kinks if len(self.limits.joints) >= self.aim.rows + 2 else Kinks(kinks.rows[:0], kinks.offsets[:0])

    def check_loops(self, joints: Array) -> None:
        """Call custom loops and tasks once in the unloaded pose `joints` (n,), and check the tip's stiffness there.

        Raises:
            ContractError: a custom loop or task raised, or returned a value that violates its interface.
            DescriptionError: the tip's stiffness is too low for the delay of the line.
            CtrError: the model has no shape in this pose.

        """
        if self.strategy.laws is None:
            self.strategy.check(self.statics.solve(joints, NO_LOAD))
        elif self.tasks:
            rest = self.statics.solve(joints, NO_LOAD)
            for task in self.tasks:
                custom_rows(task, TaskInputs(self.strategy.laws, self.feedback, rest, rest))
        if self.stiffness is not None:
            self.stiffness.check(self.statics.solve(joints, NO_LOAD), self.force_delay)

    def reset(self) -> None:
        """Reset custom loops, tasks and limits that have a state, because a motion starts.

        Raises:
            ContractError: a loop, task or limit raised.

        """
        self.strategy.reset()
        for what, parts in (("task", self.tasks), ("limit", self.limits.others)):
            for part in parts:
                reset_state(f"{what} '{name_of(part)}'", part)

    def tare(self, readings: Array, joints: Array) -> Array:
        """Return the tare (s, 6) of the base sensors from readings (s, 6) without load at joints (n,)."""
        if self.corrections is None:
            return readings
        return self.corrections.offset(self.statics.robot, joints, readings)

    def tip(self, measured: Array, rotation: Array) -> Array:
        """Return the tip's position (3,) from the coil position (3,) in a tracker frame [m].

        `rotation` (3, 3) is the frame of the innermost tube at the tip.
        """
        return measured if self.corrections is None else self.corrections.tip(measured, rotation)
