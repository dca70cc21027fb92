"""Which figures belong to which experiment."""

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
from station.report.drawn import Drawn
from station.report.run import Run

Draw = Callable[[Run], Iterator[Drawn]]

#: By the name of the experiment; any other gets the overview.
FIGURES: Mapping[str, tuple[Draw, ...]] = {
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


def figures(run: Run) -> Iterator[Drawn]:
    """All figures of a run, one after the other."""
    for draw in (*FIGURES.get(run.experiment, (overview.draw,)), timing.draw):
        yield from draw(run)
