"""Fig. 9: the force at the tip as the sensors at the tubes' bases tell it."""

import math
from collections.abc import Iterator

import numpy as np

from station.report import style
from station.report.drawn import Drawn
from station.report.run import Case, Run

#: What the paper shows of its run [s].
FROM, TO = 100.0, 200.0


def draw(run: Run) -> Iterator[Drawn]:
    """Of the first case, 100 to 200 s as in the paper; a shorter run whole."""
    if run.cases:
        case, title = run.cases[0], "Fig. 9: estimated force at the tip"
        yield force(case, "fig9", title, FROM, TO) if case.time[-1] > FROM else force(case, "fig9", title)


def force(case: Case, name: str, title: str, begin: float = 0.0, end: float = math.inf) -> Drawn:
    """Single samples, filtered and, if it is known, true force, per axis, from `begin` to `end` [s]."""
    shown = (case.time >= begin) & (case.time <= end)
    time = case.time[shown]
    figure, axes = style.stacked([f"$F_{axis}$ [N]" for axis in style.AXES])
    for column, each in enumerate(axes):
        style.draw(each, time, case.of("force")[shown, column], style.SAMPLES)
        style.draw(each, time, case.of("force_filtered")[shown, column], style.FILTERED)
        if case.truth_known:
            dashed = style.TRUE._replace(dash=(0.0, (4.0, 2.0)), width=1.0)
            style.draw(each, time, case.of("force_true")[shown, column], dashed)
    style.legend(figure, axes[:1])
    words = ""
    if case.truth_known:
        errors = (
            f"{label} {' / '.join(f'{value:.3f}' for value in rms)} N"
            for label, group in (("single samples", "force"), ("filtered", "force_filtered"))
            for rms in [np.sqrt(np.mean((case.of(group) - case.of("force_true"))[shown] ** 2, axis=0))]
        )
        words = f" RMS error in x / y / z: {', '.join(errors)}."
    return Drawn(
        name, f"{title}{case.words}",
        f"Components of the force fused from the sensors at the tubes' bases,"
        f" {time[0]:.0f} to {time[-1]:.0f} s.{words}",
        f"Force in x, y and z over time.{words}",
        figure,
    )  # fmt: skip
