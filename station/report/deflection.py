"""Figure like the paper's Fig. 4: deflection of the tip by the load, and its two parts by eq. (22)."""

from collections.abc import Iterator

import numpy as np

from station.report import style
from station.report.figure import ReportFigure
from station.report.run import RecordedRun

DEFLECTION_PARTS = (
    ("deflection", style.LineStyle(r"$\Delta_{total}$", style.BLACK, "-", 1.3)),
    ("delta_1", style.LineStyle(r"$\Delta_1$: $\int C\,\dot w\,dt$", style.BLUE, (0.0, (6.0, 1.5)), 1.4)),
    (
        "delta_2",
        style.LineStyle(r"$\Delta_2$: $\int (J(q,w) - J(q,0))\,\dot q\,dt$", style.VERMILLION, (0.0, (2.0, 1.2)), 1.6),
    ),
)


def draw(run: RecordedRun) -> Iterator[ReportFigure]:
    """Yield a figure with the total deflection, its compliance part and its Jacobian part, per axis."""
    for case in run.cases:
        figure, axes = style.stacked([rf"$\Delta_{axis}$ [mm]" for axis in style.AXES])
        for column, each in enumerate(axes):
            for group, line in DEFLECTION_PARTS:
                style.draw(each, case.time, 1e3 * case.of(group)[:, column], line)
        style.legend(figure, axes[:1])
        longest = {group: 1e3 * np.linalg.norm(case.of(group), axis=1).max() for group, _ in DEFLECTION_PARTS}
        yield ReportFigure(
            "fig4", "Fig. 4: parts of the tip deflection",
            f"The model's deflection{case.title_suffix}. Largest length: total {longest['deflection']:.2f} mm,"
            f" part of the load {longest['delta_1']:.2f} mm, part of the Jacobian {longest['delta_2']:.2f} mm:"
            f" the first is {longest['delta_1'] / longest['delta_2']:.1f} times the second. The paper has no number;"
            " it reports that the first dominates.",
            f"Deflection in x, y and z over time: the total follows the part of the load, up to"
            f" {longest['delta_1']:.2f} mm, while the Jacobian's part stays below {longest['delta_2']:.2f} mm.",
            figure,
        )  # fmt: skip
