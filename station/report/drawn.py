"""A figure with the words that belong to it."""

from typing import NamedTuple

from matplotlib.figure import Figure


class Drawn(NamedTuple):
    """One figure of a report."""

    name: str  #: of its files
    title: str
    caption: str  #: what is seen and how the numbers in it come about
    alt: str  #: for those who do not see it
    figure: Figure
