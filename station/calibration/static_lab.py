"""The virtual lab seen only at rest: averages at once instead of two seconds of samples.

The same true robot, hidden errors, play, friction, offsets, drift and counts as at wire level, and the time that the
moves would take; what a rest leaves of the noise is drawn. For trying procedures on many seeds.
"""

import math
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from core.calibration.measurements import Measurement
from core.robot.robot import Array
from station.calibration.plan import Subject
from station.calibration.procedure import AbortedError, Ask, Guided, Procedure, Swing
from station.control import approach
from station.control.settle_and_tare import AVERAGE, SETTLE
from station.lab.aurora.coil import MOUNT, VOLUME
from station.lab.aurora.distortion import Distortion
from station.lab.config import LabConfig
from station.lab.hidden import Hidden
from station.lab.loads import GRAVITY
from station.lab.netft.simulated import BoxSettings, skew
from station.lab.true_plant import true_plant

Result = TypeVar("Result")
#: The way to a pose is taken in so many steps, so that play and friction turn round as they do on the bench.
STEPS = 20
#: A person hangs a weight or takes it off in this time [s].
BY_HAND = 20.0


class StaticLab:
    """A bench that is not there and only ever rests. Everything random comes from `seed`."""

    def __init__(self, subject: Subject, config: LabConfig, seed: int) -> None:
        """Raises PoseError or NoSolution when the true robot cannot stand at the subject's start."""
        # The same streams as at wire level: the same true robot and the same hidden errors.
        plant, tracker, sensors, unknown = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(4))
        self._subject, self._config, self._rng = subject, config, sensors
        self.hidden = Hidden(subject.file, config.hidden, unknown)
        self.time = 0.0  #: [s]
        self._at = subject.start
        description = self.hidden.robot(subject.robot)
        self._plant = true_plant(description, config.plant, plant, self.hidden.joints(subject.start))
        self.true_robot = self._plant.robot
        felt, q = config.sensors, len(subject.robot.tubes)
        self._offset = np.repeat([felt.force_offset, felt.moment_offset], 3) * sensors.uniform(-1.0, 1.0, (q, 6))
        # Of each box the stream that it has at wire level, after that of its line.
        boxes = [box.spawn(2)[1] for box in sensors.spawn(q)]
        self._skew = np.array([skew(felt.gain, BoxSettings(), box) for box in boxes])
        self._wobble = sensors.spawn(1)[0]  # likewise apart: the rest is the same with and without
        self._drift = np.zeros((q, 6))
        self._drift[:, :3] = felt.drift * sensors.choice([-1.0, 1.0], (q, 3))
        self.generator = self.hidden.mount(MOUNT)  #: where the tracker really stands
        bent = config.tracker.distortion
        self._field = Distortion.drawn(bent, 1e-3 * np.array(VOLUME), tracker.spawn(1)[0]) if bent > 0.0 else None

    def measure(
        self, joints: Array, weight: float, contact: float = math.inf, direction: Array | None = None
    ) -> Measurement:
        """Go to stage positions (n,) under a weight [N], or a force on the shaft, and rest there.

        Raises:
            NoSolution: the true robot has no shape on the way.
        """
        pull = weight * (np.array(GRAVITY) if direction is None else direction)
        for part in range(1, STEPS):
            stages = self._at + part / STEPS * (joints - self._at)
            self._plant.advance(self.hidden.joints(stages), pull, contact, self.time)
        state = self._plant.advance(self.hidden.joints(joints), pull, contact, self.time)
        way = float(np.abs((joints - self._at) / self._subject.limits.speed).max()) / approach.SPEED
        self.time += way + SETTLE + 0.5 * AVERAGE
        came = np.sign(joints - self._at)
        self._at = joints.copy()
        seen, felt = self._seen(state.truth.tip), self._felt(state.wrenches)
        measurement = Measurement(self.time, joints.copy(), seen, felt, weight, came, self._axes())
        self.time += 0.5 * AVERAGE
        return measurement

    def _seen(self, tip: Array) -> Array:
        """Mean of the frames, by where the tracker is said to stand."""
        tracker = self._config.tracker
        error = tracker.noise / math.sqrt(AVERAGE * tracker.rate) * self._rng.standard_normal(3)
        return self.said(tip + self._plant.rotation @ self.hidden.coil) + error

    def _axes(self) -> Array | None:
        """Mean of the coil's axes (1, 3), by where the tracker is said to stand; None where it does not tell."""
        tracker = self._config.tracker
        if tracker.direction_noise is None:
            return None
        off = tracker.direction_noise / math.sqrt(AVERAGE * tracker.rate) * self._wobble.standard_normal(3)
        axis = self._plant.rotation @ self.hidden.coil_axis
        axis = axis + off - (off @ axis) * axis
        return (MOUNT.rotation @ self.generator.rotation.T @ axis)[None]

    def said(self, place: Array) -> Array:
        """Where a coil at `place` (3,) is said to be by a tracker believed to stand at `MOUNT`, without noise [m]."""
        there = self.generator.rotation.T @ (place - self.generator.position)
        if self._field is not None:
            there = there + self._field.at(there)
        return MOUNT.rotation @ there + MOUNT.position

    def _felt(self, wrenches: Array) -> Array:
        """Mean of the samples; their noise is larger than a count, so that counts average out with it."""
        felt = self._config.sensors
        true = self.hidden.felt(wrenches, self.hidden.joints(self._at))
        true = true + np.einsum("ijk,ik->ij", self._skew, true) + self._offset + self.time * self._drift
        count = np.array([felt.force_count, felt.moment_count])
        noise = np.sqrt(np.array([felt.force_noise, felt.moment_noise]) ** 2 + count**2 / 12.0)
        return true + np.repeat(noise, 3) / math.sqrt(500.0 * AVERAGE) * self._rng.standard_normal(true.shape)


def carry_out(
    procedure: Procedure[Result], lab: StaticLab, progress: Callable[[float, str], None] | None = None
) -> Result:
    """Run a procedure to its end; `progress` is told the part done and what a person would be asked.

    Raises:
        CtrError: what the procedure makes of the measurements.
    """
    guided, weight = Guided(procedure), 0.0
    while (step := guided.step) is not None:
        if progress is not None:
            progress(step.done, step.text if isinstance(step, Ask) else "")
        if isinstance(step, Ask):
            weight = step.weight
            lab.time += BY_HAND
            guided.answer(None)
        elif isinstance(step, Swing):
            raise AbortedError("this lab is only seen at rest: for a swing take the one with devices on their wires")
        else:
            guided.answer(lab.measure(step.joints, weight))
    if guided.result is None:
        raise AbortedError("the procedure ended without a result")
    return guided.result
