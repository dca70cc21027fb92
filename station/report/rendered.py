"""Figures as bytes: SVG for the page, PNG and PDF for whoever writes about it."""

import base64
from io import BytesIO
from pathlib import Path

from station.report.drawn import Drawn

#: Of PNG files [1/inch].
RESOLUTION = 200


def data_uri(drawn: Drawn) -> str:
    """The figure as an SVG image that a page carries in itself; the same data give the same text."""
    buffer = BytesIO()
    drawn.figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return f"data:image/svg+xml;base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"


def write_files(drawn: Drawn, folder: Path) -> None:
    """NAME.png and NAME.pdf.

    Raises:
        OSError: the folder does not take them.
    """
    drawn.figure.savefig(folder / f"{drawn.name}.png", dpi=RESOLUTION, metadata={"Description": drawn.alt})
    drawn.figure.savefig(folder / f"{drawn.name}.pdf", metadata={"Title": drawn.title, "CreationDate": None})
