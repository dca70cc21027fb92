"""How wide the force's filter opens: a load that moves quickly is followed quickly, one that stands is smoothed.

Half a hertz keeps the base sensors' noise, 0.03 N a sample and a millimetre of the tip, out of the joints, but lags a
weight that is dropped by half a second. What tells the two apart is the filter's surprise, the force less what the
filter predicts, averaged over some 20 ms: of noise alone its standard deviation is known. As far as it is larger, the
filter opens: its bandwidth grows by that factor at once, and closes again within the time that `RELEASE` says. The
filter's gains grow with the bandwidth and with its square, as those of the steady Kalman filter do.
"""

import math
from dataclasses import dataclass

import numpy as np

from core.compiled import compiled
from core.errors import DescriptionError
from core.robot.robot import Array


@dataclass(frozen=True)
class Opening:
    """When the force's filter opens, and how far."""

    noise: float = 0.03  #: standard deviation of one sample of the fused force in each axis [N]
    widest: float = 16.0  #: bandwidth at most, in multiples of that of a load at rest; 1 never opens
    memory: float = 0.02  #: over which the surprise is averaged [s]
    threshold: float = 4.5  #: standard deviations of the averaged surprise from which on the filter opens
    slope: float = 4.0  #: growth of the bandwidth for each further `threshold`
    release: float = 0.1  #: time constant in which it closes [s]

    def __post_init__(self) -> None:
        for name, value, least, unit in (
            ("noise", self.noise, 1e-6, "N"), ("widest", self.widest, 1.0, "times"), ("memory", self.memory, 1e-3, "s"),
            ("threshold", self.threshold, 1.0, "standard deviations"), ("slope", self.slope, 0.0, "times"),
            ("release", self.release, 1e-3, "s"),
        ):  # fmt: skip
            if not (math.isfinite(value) and value >= least):
                raise DescriptionError(f"force filter: {name} {value:g} {unit} must be finite and at least {least:g}")

    def settings(self, period: float) -> tuple[float, float, float, float, float]:
        """What `opened` is told: weight of a sample, bound of the surprise [N], slope, widest, part kept in a tick."""
        weight = min(1.0, period / self.memory)
        bound = self.threshold * self.noise * math.sqrt(weight / (2.0 - weight))
        return weight, bound, self.slope, self.widest, math.exp(-period / self.release)


#: Of a filter that never opens.
CLOSED = Opening(widest=1.0)


@compiled
def opened(
    last: float, old_surprise: Array, force: Array, value: Array, rate: Array, surprise: Array,
    period: float, weight: float, bound: float, slope: float, widest: float, kept: float,
) -> float:  # fmt: skip
    """How wide the filter is to be open at this tick; 1 is closed.

    Args:
        last: how wide it was at the last tick.
        old_surprise, surprise: (3,) averaged, of the last tick and, filled in, of this one [N].
        force: (3,) as measured [N].
        value, rate: (3,) what the filter knew at the last tick [N], [N/s].
        period: of a tick [s].
        weight, bound, slope, widest, kept: `Opening.settings`.

    """
    size = 0.0
    for i in range(3):
        surprise[i] = old_surprise[i] + weight * (force[i] - value[i] - period * rate[i] - old_surprise[i])
        size += surprise[i] * surprise[i]
    size = np.sqrt(size)
    wide = min(widest, 1.0 + slope * max(0.0, size / bound - 1.0))
    closing = 1.0 + kept * (last - 1.0)
    if closing < 1.001:
        closing = 1.0
    return max(wide, closing)
