"""Figure like the paper's Fig. 6: measured tip, loaded model and unloaded model while the outer tube rotates."""

from collections.abc import Iterator

import numpy as np

from core.robot.robot import Array
from station.config.controllers import PERIOD_S
from station.experiments.results import AVERAGING_TICKS, averaged_model
from station.report import style
from station.report.figure import ReportFigure
from station.report.run import RecordedCase, RecordedRun

MODELS = (("loaded", "tip_estimated", style.LOADED), ("unloaded", "tip_unloaded", style.UNLOADED))
#: Time over which the drawn distance between tip and model is averaged [s].
AVERAGING_TIME_S = 0.5


def compared(case: RecordedCase) -> tuple[Array, Array, dict[str, Array]]:
    """Return frame times (f,) [s], measured tips (f, 3) and the tips of both models at these times (f, 3) [mm]."""
    new = case.of("tip_new")[:, 0] > 0.0
    at, tips = case.of("tip_time")[new, 0], {}
    for name, group, _ in MODELS:
        model = averaged_model(case.of(group), max(1, AVERAGING_TICKS // case.stride))
        tips[name] = 1e3 * np.stack([np.interp(at, case.time, column) for column in model.T], axis=1)
    return at, 1e3 * case.of("tip_measured")[new], tips


def draw(run: RecordedRun) -> Iterator[ReportFigure]:
    """Yield figures with the positions per axis and the distance of each model."""
    for case in run.cases:
        at, measured, models = compared(case)
        counted = case.time[case.of("tip_new")[:, 0] > 0.0] >= case.counted_from - 1e-9
        if not counted.any():
            continue  # the run ended before the time from which errors count
        figure, axes = style.stacked([*(f"$X_{axis}$ [mm]" for axis in style.AXES), "distance [mm]"], height=1.3)
        for column, each in enumerate(axes[:3]):
            style.draw(each, at, measured[:, column], style.MEASURED._replace(width=2.4, alpha=0.6))
            for name, _, line in MODELS:
                style.draw(each, at, models[name][:, column], line)
        errors = {}
        for name, _, line in MODELS:
            distance = np.linalg.norm(models[name] - measured, axis=1)
            style.draw(axes[3], *style.averaged(at, distance, AVERAGING_TIME_S), line)
            errors[name] = float(distance[counted].mean())
        axes[3].set_ylim(bottom=0.0)
        style.legend(figure, axes[:1])
        text = f"mean distance: loaded model {errors['loaded']:.2f} mm, unloaded model {errors['unloaded']:.2f} mm"
        yield ReportFigure(
            "fig6" if len(run.cases) == 1 else f"fig6_{case.name}", "Fig. 6: model against measurement",
            "Measured tip and the tips of both models at the measured joints, per axis, and their distances."
            f" The models are means over {AVERAGING_TICKS * PERIOD_S:.1f} s, because the noise of one force sample"
            f" moves the loaded model by a millimetre. From {case.counted_from:g} s on, {text}."
            " The paper gives mean squared errors in mm; here it is the mean distance.",
            f"Tip position in x, y and z over time, measured and by both models; {text}.",
            figure,
        )  # fmt: skip
