"""What a person should know about a validation, in sentences."""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from core.calibration.measured import FAR, Match, Spread
from station.calibration.validation import Bin, Validation, by_direction

#: Part of the robot's length from which on a median error is asked about.
LARGE = 0.05
#: Part of the median error by which rising and falling must differ to be named.
WORTH = 0.25
#: Correlation of neighbouring errors that is said.
ALIKE = 0.3


def findings(validation: Validation) -> list[str]:
    """What a person should know, in sentences."""
    return [
        *([validation.failed] if validation.failed else []),
        *_size_words(validation),
        *_prior_words(validation.best),
        *_told_words(validation),
        *_direction_words(validation),
        *_pose_words(validation),
    ]


def _size_words(validation: Validation) -> Iterator[str]:
    """Errors that no tubes explain, and readings of the joints with which they would be less."""
    median, length = Spread.of(validation.errors[-1]).median, max(tube.length for tube in validation.robot.tubes)
    if median > LARGE * length:
        ask = "is the tips' frame the robot's? --fit frames finds it" if validation.best.fit is None else (
            "are joints, signs, units and zeros what the columns say?"
        )  # fmt: skip
        yield f"The median error is {1e3 * median:.1f} mm on a robot of {1e3 * length:.0f} mm: {ask}"
    for what, other, given in validation.suspicious[:1]:
        yield (
            f"The poses fit much better with {what}: {1e3 * other:.2f} mm mean with the frames fitted instead of"
            f" {1e3 * given:.2f} mm. Is that how they were written down?"
        )


def _told_words(validation: Validation) -> Iterator[str]:
    """How much the poses say."""
    best, count = validation.best, len(validation.poses.measurements)
    if best.held:
        names = ", ".join(name.replace("_", " ") for name in best.held)
        yield f"The data say less than was known beforehand of: {names}."
    if open_ := _open(best):
        yield f"Combinations that they cannot tell: {len(open_)}, weakest first: {'; '.join(open_[:2])}."
    if best.alike > ALIKE:
        yield (
            f"Errors of neighbouring poses are alike (correlation {best.alike:.2f}): they are the model's, not the"
            f" measurement's. {count} poses were counted as {count * (1.0 - best.alike) / (1.0 + best.alike):.0f}."
        )
    if validation.stride > 1:
        yield f"Every {validation.stride}th pose was fitted; the errors are those of all."
    for reason in best.asked.left:
        if best.extent == "tubes" or reason.startswith("lag"):
            yield f"Not asked for: {reason}."


def _direction_words(validation: Validation) -> Iterator[str]:
    """Joints whose way matters."""
    for joint, apart in _apart(by_direction(validation)):
        if apart > WORTH * Spread.of(validation.errors[-1]).median:
            yield f"{joint}: between rising and falling the mean error differs by {1e3 * apart:.2f} mm" + (
                "." if validation.best.asked.lags else "; --hysteresis fits a lag."
            )


def _pose_words(validation: Validation) -> Iterator[str]:
    """Poses that were not used, one way or another."""
    best, lengths = validation.best, np.linalg.norm(validation.errors[-1], axis=1)
    if lost := int(np.count_nonzero(~np.isfinite(lengths))):
        yield f"Poses at which this model has no shape: {lost}; they are not counted."
    if best.fit is not None and (out := [k for k, seen in enumerate(best.fitted) if not seen]):
        far = sorted(out, key=lambda k: -np.nan_to_num(lengths[validation.stride * k], nan=math.inf))
        lines = ", ".join(str(validation.poses.lines[validation.stride * k]) for k in far[:10])
        yield (
            f"Not fitted: {len(out)} of {len(best.fitted)} poses (lines {lines}), with errors of more than {FAR:g}"
            " times the median, or where the model is about to snap: another shape of the tubes, or a slip of the"
            " measurement? Their errors count."
        )
    if best.fit is not None and all(unseen.extent != best.extent for unseen in validation.unseen):
        yield "Not tested: every second pose is too few for a fit."
    for poses in (validation.poses, validation.test):
        if poses is not None and poses.left_out:
            yield f"Rows of {poses.path.name} that were left out: {len(poses.left_out)}; each is listed."


def _prior_words(best: Match) -> Iterator[str]:
    for parameter, value in best.surprising:
        yield (
            f"{parameter.name.replace('_', ' ')} came out {abs(value) / parameter.prior:.1f} standard deviations from"
            " what was known beforehand: check it, or the fit makes up for something else with it."
        )


def cannot_tell(best: Match) -> list[str]:
    """Parameters of which the data say less than was known beforehand, and combinations that they leave open."""
    return [f"{name.replace('_', ' ')}: less than was known beforehand" for name in best.held] + _open(best)


def _open(best: Match) -> list[str]:
    """Combinations, weakest first, each in what of its parameters would matter."""
    told: list[str] = []
    for combination in () if best.fit is None else best.fit.weak:
        shares = " ".join(f"{share:+.2f} {name.replace('_', ' ')}" for name, share in combination.parts)
        left = "not at all" if math.isinf(combination.open) else f"to {combination.open:.2g} times what matters"
        told.append(f"{shares} (known {left}{'; held by what was known beforehand' if combination.held else ''})")
    return told


def _apart(bins: Sequence[Bin]) -> list[tuple[str, float]]:
    """Joints, and how far the mean errors of both directions are apart [m]; pairs of bins only."""
    found: list[tuple[str, float]] = []
    for first, second in pairwise(bins):
        if first.joint == second.joint:
            found.append((first.joint, math.dist(first.along, second.along)))
    return found
