"""Step responses against the first-order lag of eq. (31)."""

from collections.abc import Iterator

import numpy as np
from matplotlib.figure import Figure

from core.robot.robot import Array
from station.experiments.step_fit import fit_step, fold
from station.report import style
from station.report.drawn import Drawn
from station.report.run import Case, Run

ANSWER = style.Look("true tip, mean of all steps", style.ORANGE, "-", 1.6)
FIT = style.Look("fit: lag with dead time", style.BLACK, (0.0, (5.0, 1.5)), 1.1)
LAW = style.Look("eq. (31): rate k, no dead time", style.BLUE, (0.0, (1.0, 1.2)), 1.3)


def draw(run: Run) -> Iterator[Drawn]:
    """A diagram for each case, as many in a row as there are axes."""
    if not run.cases:
        return
    down = -(-len(run.cases) // 3)
    figure = Figure(figsize=(style.WIDTH, 0.8 + 1.9 * down))
    grid = figure.subplots(down, min(3, len(run.cases)), sharex=True, sharey=True, squeeze=False).ravel()
    words = []
    for case, axes in zip(run.cases, grid, strict=False):
        times, answer = _folded(case)
        fit, rate = fit_step(times, answer), float(case.file["controller"]["k1"])
        style.draw(axes, times, answer, ANSWER)
        style.draw(axes, times, -np.expm1(-fit.rate * np.maximum(times - fit.dead_time, 0.0)), FIT)
        style.draw(axes, times, -np.expm1(-rate * times), LAW)
        axes.set_title(f"{_axis(case)}, k = {rate:g} 1/s\nfit {fit.rate:.2f} 1/s, {1e3 * fit.dead_time:.0f} ms")
        words.append(f"k {rate:g} {_axis(case)}: {fit.rate:.2f} 1/s after {1e3 * fit.dead_time:.0f} ms")
    for axes in grid[-min(3, len(run.cases)) :]:
        axes.set_xlabel("time since the step [s]")
    for axes in grid[:: min(3, len(run.cases))]:
        axes.set_ylabel("part of the step")
    style.legend(figure, list(grid[:1]))
    yield Drawn(
        "steps", "Step responses against eq. (31)",
        "Position of the tip along a step, there and back folded into one. The dead time is the line to the stages"
        " and their ramps.",
        "Step responses; fitted rates and dead times: " + "; ".join(words) + ".",
        figure,
    )  # fmt: skip


def _folded(case: Case) -> tuple[Array, Array]:
    motion = case.file["trajectory"]
    offset = np.array(motion["offset"], dtype=float)
    start = case.of("tip_desired")[0] - offset
    tip = case.of("tip_true" if case.truth_known else "tip_observed")
    answer = (tip - start) @ offset / float(offset @ offset)
    stay = motion.get("stay")
    return fold(case.time, answer, stay) if stay else (case.time, answer)


def _axis(case: Case) -> str:
    return style.AXES[int(np.abs(case.file["trajectory"]["offset"]).argmax())]
