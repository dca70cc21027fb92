"""Choice of the figures in a report by the name of the experiment."""

from collections.abc import Callable, Iterator, Mapping

from station.report import (
    deflection,
    follow,
    force,
    load_rate,
    model,
    overview,
    rates,
    steps,
    strategies,
    timing,
    tracking,
)
from station.report.figure import ReportFigure
from station.report.run import RecordedRun

Draw = Callable[[RecordedRun], Iterator[ReportFigure]]

#: Functions that draw the figures, by the name of the experiment; any other experiment gets the overview.
FIGURES_BY_EXPERIMENT: Mapping[str, tuple[Draw, ...]] = {
    "fig3": (strategies.draw,),
    "fig4": (deflection.draw, rates.draw),
    "fig6": (model.draw,),
    "fig7": (tracking.draw,),
    "fig8": (tracking.draw, rates.draw),
    "fig10": (tracking.draw, force.draw, rates.draw),
    "step_response": (steps.draw,),
    "load_rate": (load_rate.draw,),
    "follow": (follow.draw,),
}


def figures(run: RecordedRun) -> Iterator[ReportFigure]:
    """Yield all figures of a run's report."""
    for draw in (*FIGURES_BY_EXPERIMENT.get(run.experiment, (overview.draw,)), timing.draw):
        yield from draw(run)
