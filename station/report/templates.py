"""Conversion of figures to files: SVG for the report page, PNG and PDF for publications."""

import base64
from io import BytesIO
from pathlib import Path

from station.report.figure import ReportFigure

#: Resolution of PNG files [pixels per inch].
PNG_DPI = 200


def data_uri(drawn: ReportFigure) -> str:
    """Return the figure as an SVG image in a data URI; the same data give the same text."""
    buffer = BytesIO()
    drawn.figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return f"data:image/svg+xml;base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"


def write_files(drawn: ReportFigure, folder: Path) -> None:
    """Write a figure as NAME.png and NAME.pdf into `folder`.

    Raises:
        OSError: the files cannot be written.
    """
    drawn.figure.savefig(folder / f"{drawn.name}.png", dpi=PNG_DPI, metadata={"Description": drawn.alt})
    drawn.figure.savefig(folder / f"{drawn.name}.pdf", metadata={"Title": drawn.title, "CreationDate": None})
