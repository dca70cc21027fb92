"""What the inner loop works on: the rate of the deflection, estimated three ways, against hindsight."""

from collections.abc import Iterator

import numpy as np

from station.experiments.results import hindsight_rate
from station.report import style
from station.report.drawn import Drawn
from station.report.run import Case, Run

ESTIMATES = (
    ("deflection_rate", style.Look("filtered derivative, eq. (25)", style.ORANGE, "-", 1.2)),
    (
        "deflection_rate_exact",
        style.Look(r"exact: $C\,\dot w + (J(q,w) - J(q,0))\,\dot q$", style.BLUE, (0.0, (5.0, 1.5)), 1.2),
    ),
)
RAW = style.Look("difference of two ticks", style.SKY, "-", 0.5)
HINDSIGHT = style.Look("hindsight: cubic through one second", style.BLACK, (0.0, (1.0, 1.2)), 1.3)

COMPARED = {"raw": "deflection_rate_raw", "filtered": "deflection_rate", "exact": "deflection_rate_exact"}
#: The end of the run is shown, where nothing settles any more [s].
SHOWN = 20.0


def draw(run: Run) -> Iterator[Drawn]:
    """Of the case whose inner loop uses the rate, Type I on the tracker if there is one."""
    case = run.case("type_1") or (run.cases[0] if run.cases else None)
    if case is not None and case.stride == 1 and (hindsight := hindsight_rate(case.of("deflection"))) is not None:
        yield rates(case, 1e3 * hindsight)


def rates(case: Case, hindsight: np.ndarray) -> Drawn:
    """Per axis; `hindsight` (ticks, 3) [mm/s]."""
    labels = [rf"$\dot\Delta_{axis}$ [mm/s]" for axis in style.AXES]
    figure, axes = style.stacked([*labels, r"raw $\dot\Delta_x$ [mm/s]"], height=1.25)
    counted = case.time >= case.counted_from - 1e-9
    shown = case.time >= case.time[-1] - SHOWN
    for column, each in enumerate(axes[:3]):
        for group, look in ESTIMATES:
            style.draw(each, case.time[shown], 1e3 * case.of(group)[shown, column], look)
        style.draw(each, case.time[shown], hindsight[shown, column], HINDSIGHT)
    style.draw(axes[3], case.time[shown], 1e3 * case.of("deflection_rate_raw")[shown, 0], RAW)
    style.legend(figure, axes, columns=2)

    def rms(group: str) -> str:
        difference = (1e3 * case.of(group) - hindsight)[counted]
        return " / ".join(f"{value:.3g}" for value in np.sqrt(np.mean(difference**2, axis=0)))

    errors = (f"{name} {rms(group)} mm/s" for name, group in COMPARED.items())
    words = f"RMS difference from hindsight in x / y / z: {'; '.join(errors)}."
    return Drawn(
        "rates", f"Rate of the deflection{case.words}",
        f"Estimates of the rate of Delta_total against what it turned out to be, last {SHOWN:g} s. {words}"
        " The raw difference of two ticks, which carries all noise of the force sensors, has a diagram of its own.",
        f"Deflection rates in x, y and z over time. {words}",
        figure,
    )  # fmt: skip
