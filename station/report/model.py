"""Fig. 6: the measured tip against the loaded and the unloaded model while the outer tube turns."""

from collections.abc import Iterator

import numpy as np

from station.report import style
from station.report.drawn import Drawn
from station.report.run import Case, Run

MODELS = (("loaded", "tip_estimated", style.LOADED), ("unloaded", "tip_unloaded", style.UNLOADED))

#: The loaded model carries the force sensors' noise; its lines are means over this time [s].
SPAN = 0.5


def model_errors(case: Case) -> dict[str, float]:
    """Mean distance of either model from the measured tip, at the tracker's frames after the settling time [mm]."""
    new = (case.of("tip_new")[:, 0] > 0.0) & (case.time >= case.settling - 1e-9)
    at = case.of("tip_time")[new, 0]
    measured = case.of("tip_measured")[new]
    errors = {}
    for name, group, _ in MODELS:
        model = np.stack([np.interp(at, case.time, column) for column in case.of(group).T], axis=1)
        errors[name] = float(1e3 * np.linalg.norm(model - measured, axis=1).mean())
    return errors


def draw(run: Run) -> Iterator[Drawn]:
    """Positions per axis, and the distance of either model."""
    for case in run.cases:
        figure, axes = style.stacked([*(f"$X_{axis}$ [mm]" for axis in style.AXES), "distance [mm]"], height=1.3)
        new = case.of("tip_new")[:, 0] > 0.0
        at, measured = case.of("tip_time")[new, 0], 1e3 * case.of("tip_measured")[new]
        for column, each in enumerate(axes[:3]):
            style.draw(each, at, measured[:, column], style.MEASURED._replace(width=2.4, alpha=0.6))
            for _, group, look in MODELS:
                style.draw(each, *style.averaged(case.time, 1e3 * case.of(group)[:, column], SPAN), look)
        for _, group, look in MODELS:
            model = np.stack([np.interp(at, case.time, 1e3 * column) for column in case.of(group).T], axis=1)
            style.draw(axes[3], *style.averaged(at, np.linalg.norm(model - measured, axis=1), SPAN), look)
        axes[3].set_ylim(bottom=0.0)
        style.legend(figure, axes[:1])
        errors = model_errors(case)
        text = f"mean distance: loaded model {errors['loaded']:.2f} mm, unloaded model {errors['unloaded']:.2f} mm"
        yield Drawn(
            "fig6" if len(run.cases) == 1 else f"fig6_{case.name}", "Fig. 6: model against measurement",
            f"Measured tip and the tip of either model at the measured joints, per axis, and how far they are apart;"
            f" the lines are means over {SPAN:g} s. Of all frames, {text}, after {case.settling:g} s."
            " The paper calls its numbers mean squared errors and gives them in mm; here it is the mean distance.",
            f"Tip position in x, y and z over time, measured and by both models; {text}.",
            figure,
        )  # fmt: skip
