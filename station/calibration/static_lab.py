"""A virtual lab that simulates the bench at rest only, so that a procedure can be tested quickly with many seeds.

This lab computes the average of a measurement directly, with random noise, instead of simulating two seconds of
samples. Its plant, hidden errors, play and friction are those of the lab with wire-level devices. Sensor offsets, drift
and quantisation have the same size as there. The lab counts simulated time: the durations of moves, rests and handling.
"""

import math
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from core.calibration.measurements import Measurement
from core.robot.robot import Array
from station.calibration.plan import PlanSubject
from station.calibration.procedure import AbortedError, GuidedProcedure, OperatorPrompt, Procedure, SwingMotion
from station.config.loads import GRAVITY
from station.control.task import AVERAGE_S, SETTLE_S, SPEED_SHARE
from station.lab.aurora_coil import GENERATOR_POSE, VOLUME_MM, Distortion
from station.lab.config import LabConfig
from station.lab.frictional_plant import true_plant
from station.lab.simulated_netft import BoxSettings, gain_errors
from station.lab.unmodelled_errors import UnmodelledErrors

Result = TypeVar("Result")
#: Number of simulated steps of a move to a pose. Play and friction depend on the path, so one step is not sufficient.
PATH_STEPS = 20
#: Time in which the operator hangs or removes a weight [s].
HANDLING_TIME_S = 20.0


class StaticLab:
    """A simulated bench that is only measured at rest. `seed` determines everything random."""

    def __init__(self, subject: PlanSubject, config: LabConfig, seed: int) -> None:
        """Create the simulated bench at rest at the start pose of `subject`.

        Raises:
            PoseError, NoSolution: the plant (simulated real robot) has no shape at the start pose.
        """
        # `SimulatedBench` derives its random streams from the seed in the same way. A seed therefore gives the same
        # plant and the same hidden errors in both labs.
        plant, tracker, sensors, unknown = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(4))
        self._subject, self._config, self._rng = subject, config, sensors
        self.hidden = UnmodelledErrors(subject.file, config.hidden, unknown)
        self.time = 0.0  #: simulated time since the start [s]
        self._position = subject.start
        description = self.hidden.robot(subject.robot)
        self._plant = true_plant(description, config.plant, plant, self.hidden.joints(subject.start))
        self.true_robot = self._plant.robot
        settings, s = config.sensors, len(subject.robot.sensor_names)
        self._offset = np.repeat([settings.force_offset, settings.moment_offset], 3) * sensors.uniform(
            -1.0, 1.0, (s, 6)
        )
        # `SimulatedNetft` creates three random streams per force sensor: lost datagrams, gain errors, signs of the
        # moments' drift. This lab has no datagrams, so it uses only the other two.
        boxes = [box.spawn(3)[1:] for box in sensors.spawn(s)]
        self._skew = np.array([gain_errors(settings.gain, BoxSettings(), crossed) for crossed, _ in boxes])
        self._wobble = sensors.spawn(1)[0]  # separate random stream, so that the other random numbers do not change
        self._drift = np.zeros((s, 6))
        self._drift[:, :3] = settings.drift * sensors.choice([-1.0, 1.0], (s, 3))
        self._drift[:, 3:] = settings.moment_drift * np.array([signs.choice([-1.0, 1.0], 3) for _, signs in boxes])
        self.generator = self.hidden.mount(GENERATOR_POSE)  #: true pose of the tracker
        bent = config.tracker.distortion
        self._field = Distortion.drawn(bent, 1e-3 * np.array(VOLUME_MM), tracker.spawn(1)[0]) if bent > 0.0 else None

    def measure(
        self, joints: Array, weight: float, contact: float = math.inf, direction: Array | None = None
    ) -> Measurement:
        """Move to stage positions (n,) under a weight [N], or a force on the shaft, and return the measurement at rest.

        Raises:
            NoSolution: the plant (simulated real robot) has no shape along the path.
        """
        pull = weight * (np.array(GRAVITY) if direction is None else direction)
        for part in range(1, PATH_STEPS):
            stages = self._position + part / PATH_STEPS * (joints - self._position)
            self._plant.advance(self.hidden.joints(stages), pull, contact, self.time)
        state = self._plant.advance(self.hidden.joints(joints), pull, contact, self.time)
        duration = float(np.abs((joints - self._position) / self._subject.limits.speed).max()) / SPEED_SHARE
        self.time += duration + SETTLE_S + 0.5 * AVERAGE_S
        arrival = np.sign(joints - self._position)
        self._position = joints.copy()
        coil, wrenches = self._mean_coil(state.truth.tip), self._mean_wrenches(state.wrenches)
        measurement = Measurement(self.time, joints.copy(), coil, wrenches, weight, arrival, self._axes())
        self.time += 0.5 * AVERAGE_S
        return measurement

    def _mean_coil(self, tip: Array) -> Array:
        """Return the mean position of the coil in the tracker's frames, for the assumed pose of the tracker [m]."""
        tracker = self._config.tracker
        error = tracker.noise / math.sqrt(AVERAGE_S * tracker.rate) * self._rng.standard_normal(3)
        return self.reported_position(tip + self._plant.rotation @ self.hidden.coil) + error

    def _axes(self) -> Array | None:
        """Return the mean of the coil's axes (1, 3), for the assumed pose of the tracker; None without an axis."""
        tracker = self._config.tracker
        if tracker.direction_noise is None:
            return None
        error = tracker.direction_noise / math.sqrt(AVERAGE_S * tracker.rate) * self._wobble.standard_normal(3)
        axis = self._plant.rotation @ self.hidden.coil_axis
        axis = axis + error - (error @ axis) * axis
        return (GENERATOR_POSE.rotation @ self.generator.rotation.T @ axis)[None]

    def reported_position(self, coil: Array) -> Array:
        """Return the position (3,) that a tracker with the assumed `GENERATOR_POSE` reports, without noise [m]."""
        local = self.generator.rotation.T @ (coil - self.generator.position)
        if self._field is not None:
            local = local + self._field.at(local)
        return GENERATOR_POSE.rotation @ local + GENERATOR_POSE.position

    def _mean_wrenches(self, wrenches: Array) -> Array:
        """Return the mean of the sensors' samples, without quantisation.

        The noise of a sample exceeds the quantisation step, so quantisation averages out.
        """
        settings = self._config.sensors
        true = self.hidden.felt(wrenches, self.hidden.joints(self._position), self._plant.tubes_at)
        true = true + np.einsum("ijk,ik->ij", self._skew, true) + self._offset + self.time * self._drift
        count = np.array([settings.force_count, settings.moment_count])
        noise = np.sqrt(np.array([settings.force_noise, settings.moment_noise]) ** 2 + count**2 / 12.0)
        return true + np.repeat(noise, 3) / math.sqrt(500.0 * AVERAGE_S) * self._rng.standard_normal(true.shape)


def run_static(
    procedure: Procedure[Result], lab: StaticLab, progress: Callable[[float, str], None] | None = None
) -> Result:
    """Run a procedure to its end; `progress` receives the completed share and the prompt for the operator.

    Raises:
        CtrError: the procedure rejects the measurements.
    """
    guided, weight = GuidedProcedure(procedure), 0.0
    while (step := guided.step) is not None:
        if progress is not None:
            progress(step.done, step.text if isinstance(step, OperatorPrompt) else "")
        if isinstance(step, OperatorPrompt):
            weight = step.weight
            lab.time += HANDLING_TIME_S
            guided.answer(None)
        elif isinstance(step, SwingMotion):
            raise AbortedError("this lab simulates rest only: moving joints need the lab with wire-level devices")
        else:
            guided.answer(lab.measure(step.joints, weight))
    return guided.outcome()
