"""Data type for a figure of a report with its texts."""

from typing import NamedTuple

from matplotlib.figure import Figure


class ReportFigure(NamedTuple):
    """One figure of a report, with its title, caption and text alternative."""

    name: str  #: name of the figure's PNG and PDF files
    title: str
    caption: str  #: content of the figure and origin of its numbers
    alt: str  #: text alternative for readers who cannot see the figure
    figure: Figure
