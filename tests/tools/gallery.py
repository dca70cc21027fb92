"""Make the gallery: `python -m tests.tools.gallery FOLDER [EXPERIMENT ...]`.

Each experiment is run in virtual time. Its figures, its report and its 3D replay are written to a folder of its name,
and `index.html` links to them. Above them are pictures of the browser panel with its light and its dark theme, which
need Chromium. All pages open without a server and load nothing from a network. The default is every preset experiment,
which takes minutes; the files are large and do not belong into the repository.
"""

import argparse
import subprocess
import sys
from collections.abc import Iterable
from html import escape
from pathlib import Path
from urllib.parse import quote

from station.config.strict import preset_names
from station.experiments.experiment import load_experiment
from station.recording.history import resolve_run
from station.report.page import write_report
from station.report.player import write_player

PAGE = """<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>Gallery</title><style>
:root {{ color-scheme: light dark; font: 14px system-ui; }} body {{ max-width: 72rem; margin: 2rem auto; }}
section {{ margin-block: 2rem; }} img {{ max-width: 100%; background: white; border-radius: 4px; }}
</style><h1>Gallery</h1><p>All results are simulated: they come from the virtual lab.</p>
{sections}</html>
"""
PANEL = """<section><h2>Browser panel</h2>
<img alt="the panel with the light theme" src="panel/run.png">
<img alt="the panel with the dark theme" src="panel/dark.png"></section>
"""
SECTION = """<section><h2>{title}</h2><p><code>{name}</code> · <a href="{path}/replay.html">3D replay</a> ·
<a href="{path}/report.html">report</a></p><img alt="{name}: first figure of the report" src="{figure}"></section>
"""


def section(name: str, title: str, figure: str) -> str:
    """Return the section of an experiment; `figure` is the path of its picture in the gallery."""
    return SECTION.format(name=escape(name), title=escape(title), path=quote(name), figure=quote(figure))


def exhibit(name: str, out: Path) -> str:
    """Run an experiment, write its pages to `out/name`, and return its section of the index."""
    data = out / "runs" / name
    subprocess.run([sys.executable, "-m", "station", "run", name, "--data", data], check=True)
    run, folder = resolve_run("latest", data), out / name
    folder.mkdir(parents=True, exist_ok=True)
    write_report(run, folder)
    write_player(run, folder / "replay.html", lambda done: None)
    figure = sorted(folder.glob("*.png"))[0]
    title = load_experiment(name).title or name
    return section(name, title, figure.relative_to(out).as_posix())


def panel(out: Path) -> str:
    """Write the pictures of the browser panel to `out/panel`, and return their section of the index.

    Without pictures, for example on a busy computer or without Chromium, the section is empty.
    """
    folder = out / "panel"
    folder.mkdir(parents=True, exist_ok=True)
    done = subprocess.run([sys.executable, "-m", "tests.tools.page_pictures", folder, "run", "dark"])
    if done.returncode != 0:
        sys.stderr.write("The gallery has no pictures of the panel; run the command again on an idle computer.\n")
        return ""
    return PANEL


def gallery(out: Path, names: Iterable[str]) -> Path:
    """Write the pages of all experiments and the index; return the path of the index."""
    index = out / "index.html"
    sections = [panel(out), *(exhibit(name, out) for name in names)]
    index.write_text(PAGE.format(sections="".join(sections)), encoding="utf-8")
    return index


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m tests.tools.gallery", description="Make the gallery.")
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="folder of the gallery")
    parser.add_argument(
        "names", nargs="*", metavar="EXPERIMENT", choices=[[], *preset_names("experiments")],
        help="experiment to show; default: every preset experiment",
    )  # fmt: skip
    given = parser.parse_args()
    sys.stdout.write(f"{gallery(given.folder.absolute(), given.names or preset_names('experiments'))}\n")
