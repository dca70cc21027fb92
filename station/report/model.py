"""Fig. 6: the measured tip against the loaded and the unloaded model while the outer tube turns."""

from collections.abc import Iterator

import numpy as np

from core.robot.robot import Array
from station.config.controllers import PERIOD
from station.experiments.results import AVERAGED, averaged_model
from station.report import style
from station.report.drawn import Drawn
from station.report.run import Case, Run

MODELS = (("loaded", "tip_estimated", style.LOADED), ("unloaded", "tip_unloaded", style.UNLOADED))
#: The line of the distance is a mean over this time [s].
SPAN = 0.5


def compared(case: Case) -> tuple[Array, Array, dict[str, Array]]:
    """Times of the tracker's frames (f,) [s], measured tips (f, 3) and those of either model then (f, 3) [mm]."""
    new = case.of("tip_new")[:, 0] > 0.0
    at, tips = case.of("tip_time")[new, 0], {}
    for name, group, _ in MODELS:
        model = averaged_model(case.of(group), max(1, AVERAGED // case.stride))
        tips[name] = 1e3 * np.stack([np.interp(at, case.time, column) for column in model.T], axis=1)
    return at, 1e3 * case.of("tip_measured")[new], tips


def draw(run: Run) -> Iterator[Drawn]:
    """Positions per axis, and the distance of either model."""
    for case in run.cases:
        at, measured, models = compared(case)
        counted = case.time[case.of("tip_new")[:, 0] > 0.0] >= case.counted_from - 1e-9
        if not counted.any():
            continue  # it ended before anything counts
        figure, axes = style.stacked([*(f"$X_{axis}$ [mm]" for axis in style.AXES), "distance [mm]"], height=1.3)
        for column, each in enumerate(axes[:3]):
            style.draw(each, at, measured[:, column], style.MEASURED._replace(width=2.4, alpha=0.6))
            for name, _, look in MODELS:
                style.draw(each, at, models[name][:, column], look)
        errors = {}
        for name, _, look in MODELS:
            distance = np.linalg.norm(models[name] - measured, axis=1)
            style.draw(axes[3], *style.averaged(at, distance, SPAN), look)
            errors[name] = float(distance[counted].mean())
        axes[3].set_ylim(bottom=0.0)
        style.legend(figure, axes[:1])
        text = f"mean distance: loaded model {errors['loaded']:.2f} mm, unloaded model {errors['unloaded']:.2f} mm"
        yield Drawn(
            "fig6" if len(run.cases) == 1 else f"fig6_{case.name}", "Fig. 6: model against measurement",
            "Measured tip and the tip of either model at the measured joints, per axis, and how far they are apart."
            f" The models are means over {AVERAGED * PERIOD:.1f} s: single force samples move the loaded one by a"
            f" millimetre, which says nothing about the model. From {case.counted_from:g} s on, {text}."
            " The paper calls its numbers mean squared errors and gives them in mm; here it is the mean distance.",
            f"Tip position in x, y and z over time, measured and by both models; {text}.",
            figure,
        )  # fmt: skip
