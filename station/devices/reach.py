"""Text on how far a stage that no longer receives commands can still move."""

import math

from station.config.robots import JointFile


def reach(joint: JointFile, last: float, end: float, moving: bool) -> str:
    """Return the text for a stage last measured at `last`, whose hardware limit ahead is `end` [rad or m]."""
    if not moving or not math.isfinite(last):
        return "its position was unknown" if moving else "it was not moving"
    scale, unit = (180.0 / math.pi, "deg") if joint.motion == "rotation" else (1e3, "mm")
    return (
        f"last seen at {scale * last:.1f} {unit}, it can run on to {scale * end:.1f} {unit},"
        f" {scale * abs(end - last):.1f} {unit} away (hardware limit)"
    )
