"""The channels of a run: one row of numbers a tick, the same for recordings and live views."""

from typing import NamedTuple

import numpy as np

from core.robot import Array, Robot
from core.step import Tick
from station.devices.interfaces import JointReading, TipReading, Truth, WrenchReading
from station.states import State

XYZ = ("x", "y", "z")


class Channel(NamedTuple):
    """One named column of every row."""

    name: str
    unit: str

    @property
    def column(self) -> str:
        """Name with the unit, as in file headers."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


class Channels:
    """Names, units and places of all columns for one robot."""

    def __init__(self, robot: Robot) -> None:
        self.all: tuple[Channel, ...] = tuple(_channels(robot))
        self._at: dict[str, slice] = {}
        names = [channel.name for channel in self.all]
        groups = [name.rsplit(".", 1)[0] for name in names]
        for group in dict.fromkeys(groups):
            self._at[group] = slice(groups.index(group), groups.index(group) + groups.count(group))

    def __len__(self) -> int:
        return len(self.all)

    @property
    def groups(self) -> tuple[str, ...]:
        """Names that `of` takes."""
        return tuple(self._at)

    def of(self, rows: Array, group: str) -> Array:
        """The columns of a group, e.g. `tip_measured`: (..., 3)."""
        return rows[..., self._at[group]]

    def row(
        self,
        time: float,
        state: State,
        joints: JointReading,
        wrenches: WrenchReading,
        frame: TipReading | None,
        tick: Tick,
        truth: Truth | None,
    ) -> Array:
        """One tick as numbers, in the order of `all`.

        Between tracker frames `tip_new` is 0 and the last frame's values stand. Without a virtual
        lab nothing is known to be true: `truth_known` is 0 and the true channels are 0.
        """
        memory, now = tick.memory, tick.memory.estimate
        observed = now.observed
        desired = memory.origin + tick.setpoint.position
        true = (1.0, *truth.tip, *truth.force) if truth else (0.0,) * 7
        return np.concatenate(
            (
                (time, state),
                joints.positions,
                tick.command,
                joints.sent,
                wrenches.wrenches.ravel(),
                tick.load.force,
                tick.load.moment,
                (0.0, 0.0) if frame is None else (1.0, frame.time),
                memory.tip,
                now.loaded.tip,
                now.unloaded.tip,
                desired,
                true,
                tick.u_int,
                now.difference,
                now.difference_rate,
                now.deflection.rate,
                now.delta_1,
                now.delta_2,
                tick.sigma,
                tick.at_bound,
                (now.loaded.iterations, now.unloaded.iterations),
                now.deflection_rate_exact,
                tick.delta,
                observed.tip,
                now.velocity,
                observed.bias,
                (observed.uncertainty, observed.used),
                now.force.value,
                (now.loaded.stability,),
            )
        )


def _channels(robot: Robot) -> list[Channel]:
    def vector(group: str, unit: str) -> list[Channel]:
        return [Channel(f"{group}.{axis}", unit) for axis in XYZ]

    def joints(group: str, per: str = "") -> list[Channel]:
        return [Channel(f"{group}.{joint.name}", joint.unit + per) for joint in robot.joints]

    raw = [
        Channel(f"wrench_raw.{tube.name}_{kind}{axis}", unit)
        for tube in robot.tubes
        for kind, unit in (("f", "N"), ("m", "N m"))
        for axis in XYZ
    ]
    sigma = [Channel(f"sigma.{number}", "m/s") for number in range(1, min(3, len(robot.joints)) + 1)]
    return [
        Channel("time", "s"),
        Channel("state", ""),
        *joints("joints"),
        *joints("velocity_commanded", "/s"),
        *joints("velocity_sent", "/s"),
        *raw,
        *vector("force", "N"),
        *vector("moment", "N m"),
        Channel("tip_new", ""),
        Channel("tip_time", "s"),
        *vector("tip_measured", "m"),
        *vector("tip_estimated", "m"),
        *vector("tip_unloaded", "m"),
        *vector("tip_desired", "m"),
        Channel("truth_known", ""),
        *vector("tip_true", "m"),
        *vector("force_true", "N"),
        *vector("u_int", "m/s"),
        *vector("deflection", "m"),
        *vector("deflection_rate_raw", "m/s"),
        *vector("deflection_rate", "m/s"),
        *vector("delta_1", "m"),
        *vector("delta_2", "m"),
        *sigma,
        *[Channel(f"at_bound.{joint.name}", "") for joint in robot.joints],
        Channel("passes.loaded", ""),
        Channel("passes.unloaded", ""),
        *vector("deflection_rate_exact", "m/s"),
        *vector("delta", "m/s"),
        *vector("tip_observed", "m"),
        *vector("velocity_observed", "m/s"),
        *vector("bias", "m"),
        Channel("observer.uncertainty", "m"),
        Channel("observer.used", ""),
        *vector("force_filtered", "N"),
        Channel("stability", ""),
    ]
