"""Fraction of time for which joints are at a limit while the tip follows a target."""

from collections.abc import Mapping, Sequence

import numpy as np

from core.robot.robot import Array

#: Smallest fraction of time at a limit for which a joint is named in the warning; rarer limits have no visible effect.
NAMED_PART = 0.02


def limited_parts(names: Sequence[str], at_bound: Array, followed: Array) -> dict[str, float]:
    """Return the fraction of time that each joint is at a limit while the tip follows a target.

    `at_bound` (m, n) and `followed` (m,) are positive at ticks at which a joint is at a limit or the tip follows.
    """
    ticks = at_bound[followed > 0.0] != 0.0
    parts = ticks.mean(axis=0) if len(ticks) else np.zeros(len(names))
    return dict(zip(names, parts.tolist(), strict=True))


def saturation_warning(parts: Mapping[str, float]) -> str:
    """Return a warning about joints that are often at their limits, or an empty text."""
    named = [f"{joint} {100.0 * part:.0f} %" for joint, part in parts.items() if part > NAMED_PART]
    if not named:
        return ""
    return (
        f"the target's path needs more than the stages have: at a limit of speed or travel {', '.join(named)} of the"
        " time, and the tip falls behind; start from a pose with more room, or use quicker stages"
    )
