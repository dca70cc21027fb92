"""Findings of a validation, which compares a model with measured poses, as sentences."""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from core.calibration.external_poses import OUTLIER_RATIO, ErrorStatistics, PoseFit
from station.calibration.validation import ErrorBin, Validation, by_direction

#: Share of the robot's length above which a finding questions the median error.
LARGE_ERROR_SHARE = 0.05
#: Share of the median error above which a finding reports that errors differ between arrivals from below and
#: from above.
MIN_DIRECTION_DIFFERENCE = 0.25
#: Difference of the mean errors of two groups that pure noise exceeds in one of 1000 cases: the root of the quantile of
#: the chi-square distribution with three degrees of freedom, relative to the median length of the errors (Maxwell).
CHANCE = 2.62
#: Correlation of neighbouring errors above which a finding reports the correlation.
MIN_CORRELATION = 0.3


def findings(validation: Validation) -> list[str]:
    """Return the findings as sentences."""
    return [
        *([validation.failed] if validation.failed else []),
        *_size_sentences(validation),
        *_prior_sentences(validation.best),
        *_information_sentences(validation),
        *_residual_words(validation),
        *_learned_words(validation),
        *_direction_sentences(validation),
        *_pose_sentences(validation),
    ]


def _size_sentences(validation: Validation) -> Iterator[str]:
    """Report errors that are too large for wrong tubes, and interpretations of the columns with smaller errors."""
    median, length = (
        ErrorStatistics.of(validation.errors[-1]).median,
        max(tube.length for tube in validation.robot.tubes),
    )
    if median > LARGE_ERROR_SHARE * length:
        question = "are the tips in the robot's frame? --fit frames finds it" if validation.best.fit is None else (
            "do joints, signs, units and zeros agree with the columns' names?"
        )  # fmt: skip
        yield f"The median error is {1e3 * median:.1f} mm on a robot of {1e3 * length:.0f} mm: {question}"
    for what, other, given in validation.suspicious[:1]:
        yield (
            f"The poses fit much better with {what}: {1e3 * other:.2f} mm mean with the frames fitted instead of"
            f" {1e3 * given:.2f} mm. Were they written down like this?"
        )


def _information_sentences(validation: Validation) -> Iterator[str]:
    """Report how many parameters the poses determine."""
    best, count = validation.best, len(validation.poses.measurements)
    if best.fixed_by_prior:
        names = ", ".join(name.replace("_", " ") for name in best.fixed_by_prior)
        yield f"The priors determine these parameters more than the data: {names}."
    if open_ := _open_combinations(best):
        yield f"Combinations that the data do not determine: {len(open_)}, weakest first: {'; '.join(open_[:2])}."
    correlation = best.neighbour_correlation
    if correlation > MIN_CORRELATION:
        yield (
            f"Errors of neighbouring poses are correlated ({correlation:.2f}): they come from the model, not from the"
            f" measurement. {count} poses were counted as {count * (1.0 - correlation) / (1.0 + correlation):.0f}."
        )
    if validation.stride > 1:
        yield f"Every {validation.stride}th pose was fitted; the errors are those of all poses."
    for reason in best.requested.omitted:
        if best.extent in ("tubes", "friction", "residual") or reason.startswith("lag"):
            yield f"Not fitted: {reason}."


def _residual_words(validation: Validation) -> Iterator[str]:
    """Report whether the residual is friction or smooth, and the effect of a learned correction."""
    left = validation.residual
    if left.kind == "unknown" or validation.best.fit is None:
        return
    parts = [f"the joints predict {_percent(left.smooth)} of the squared residual"]
    if math.isfinite(left.motion):
        parts.append(f"joints and previous motions {_percent(left.motion)}")
    kinds = {
        "friction": "The residual is friction: it depends on the motions before a pose",
        "smooth": "The residual is smooth over the joints",
        "neither": "The residual is neither smooth over the joints nor friction",
    }
    text = f"{kinds[left.kind]} ({', '.join(parts)}; cross-validated)."
    if left.kind == "friction" and validation.best.extent != "friction":
        text += " --fit friction fits a wind-up of each tube."
    yield text
    if left.kind != "neither":
        yield (
            f"A learned correction of {'joints and motions' if left.kind == 'friction' else 'the joints'} would reduce"
            f" the mean error from {1e3 * left.mean:.3f} to {1e3 * left.learned:.3f} mm at held-out poses."
        )
    if not validation.poses.timed:
        yield "The poses have no order: add a column 'time' [s] to separate friction from a smooth residual."
    elif left.last_pose > MIN_CORRELATION:
        yield f"The errors of consecutive poses are correlated ({left.last_pose:.2f})."


def _learned_words(validation: Validation) -> Iterator[str]:
    """Report the learned residual: its size, what limits it, and its effect outside its data."""
    best, outside = validation.best, validation.extrapolation
    if best.extent != "residual":
        return
    if best.learned is None:
        yield "No residual was learned, because none predicts the errors on held-out trajectories."
        return
    yield (
        f"The residual is learned from {len(best.learned.support)} support points; {_percent(best.learned.strength)} of"
        " the prediction is used, the part that fits held-out trajectories best."
    )
    if outside is not None:
        yield (
            f"Outside its data, in the {outside.where}: mean error {1e3 * outside.model:.3f} mm without and"
            f" {1e3 * outside.corrected:.3f} mm with the residual of the other half, the least favourable of all halves"
            "."
        )


def _percent(part: float) -> str:
    return f"{100.0 * max(part, 0.0):.0f} %"


def _direction_sentences(validation: Validation) -> Iterator[str]:
    """Report joints whose direction of arrival at a pose changes the mean error."""
    median = ErrorStatistics.of(validation.errors[-1]).median
    for joint, apart, ratio in _direction_differences(by_direction(validation)):
        if apart > max(MIN_DIRECTION_DIFFERENCE, CHANCE * ratio) * median:
            yield f"{joint}: the mean error differs by {1e3 * apart:.2f} mm between rising and falling" + (
                "."
                if validation.best.requested.lags or validation.best.requested.windups
                else "; --hysteresis fits a lag."
            )


def _pose_sentences(validation: Validation) -> Iterator[str]:
    """Report poses that were not used."""
    best, lengths = validation.best, np.linalg.norm(validation.errors[-1], axis=1)
    if lost := int(np.count_nonzero(~np.isfinite(lengths))):
        yield f"Poses at which this model has no shape: {lost}; they are not counted."
    if best.fit is not None and (out := [k for k, used in enumerate(best.fitted) if not used]):
        worst = sorted(out, key=lambda k: -np.nan_to_num(lengths[validation.stride * k], nan=math.inf))
        lines = ", ".join(str(validation.poses.lines[validation.stride * k]) for k in worst[:10])
        yield (
            f"Not fitted: {len(out)} of {len(best.fitted)} poses (lines {lines}), with errors of more than"
            f" {OUTLIER_RATIO:g}"
            " times the median, or with the model about to snap: do the tubes have another shape, or is the measurement"
            " wrong? The table of errors includes them."
        )
    if best.fit is not None and all(held_out.extent != best.extent for held_out in validation.held_out):
        yield "Not tested: half of the poses are too few for a fit."
    for poses in (validation.poses, validation.test):
        if poses is not None and poses.moved_flush > 1e-9:
            yield (
                f"{poses.path.name}: tubes that end up to {1e3 * poses.moved_flush:.3f} mm behind their outer"
                " neighbour's end were read as flush with it."
            )
        if poses is not None and poses.left_out:
            yield f"Rows of {poses.path.name} that were left out: {len(poses.left_out)}; each is listed."


def _prior_sentences(best: PoseFit) -> Iterator[str]:
    for parameter, value in best.far_from_prior:
        yield (
            f"{parameter.name.replace('_', ' ')} came out {abs(value) / parameter.prior:.1f} standard deviations from"
            " the prior: check it, because the fit may compensate another error with it."
        )


def undetermined_parameters(best: PoseFit) -> list[str]:
    """Return the parameters that the priors determine, and the combinations that the data do not determine."""
    return [f"{name.replace('_', ' ')}: determined by the prior" for name in best.fixed_by_prior] + _open_combinations(
        best
    )


def _open_combinations(best: PoseFit) -> list[str]:
    """Return combinations that the data do not determine, weakest first, in units of the parameters' relevant sizes."""
    texts: list[str] = []
    for combination in () if best.fit is None else best.fit.weak:
        shares = " ".join(f"{share:+.2f} {name.replace('_', ' ')}" for name, share in combination.parts)
        left = "not at all" if math.isinf(combination.open) else f"to {combination.open:.2g} times the relevant size"
        texts.append(f"{shares} (known {left}{'; determined by the prior' if combination.fixed_by_prior else ''})")
    return texts


def _direction_differences(bins: Sequence[ErrorBin]) -> list[tuple[str, float, float]]:
    """Return joints with the difference of mean errors between both directions [m]; omit joints with one direction.

    The third value is the standard deviation of such a difference for errors with the standard deviation 1.
    """
    found: list[tuple[str, float, float]] = []
    for first, second in pairwise(bins):
        if first.joint == second.joint:
            ratio = math.sqrt(1.0 / max(first.spread.poses, 1) + 1.0 / max(second.spread.poses, 1))
            found.append((first.joint, math.dist(first.along, second.along), ratio))
    return found
