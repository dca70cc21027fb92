"""Text on how far a stage that no longer receives commands can still move."""

import math

from station.config.robots import JointFile


def reach(joint: JointFile, last: float, end: float, moving: bool, brakes_within: float | None = None) -> str:
    """Return the text for a stage that no longer receives commands.

    Args:
        joint: the stage's joint.
        last: position when it was last measured [rad or m]; NaN: unknown.
        end: hardware limit ahead of it [rad or m].
        moving: whether the last command was a motion.
        brakes_within: time after which the stage brakes by itself without commands [s]; None: it does not.
    """
    if not moving and brakes_within is None:
        return "it was not moving"
    if not math.isfinite(last):
        return "its position was unknown"
    scale, unit = (180.0 / math.pi, "deg") if joint.motion == "rotation" else (1e3, "mm")
    seen = f"last seen at {scale * last:.1f} {unit}"
    if brakes_within is not None:
        return f"{seen}, it brakes by itself within {brakes_within:g} s"
    return (
        f"{seen}, it can run on to {scale * end:.1f} {unit}, {scale * abs(end - last):.1f} {unit} away (hardware limit)"
    )
