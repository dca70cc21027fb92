"""Pages of the site: the repository's Markdown files at their places in the site, and the generated reference.

Every text has one source. `PAGES` names the page of each Markdown file outside `pages/`. Links between files become
links between pages; a link to a file that is not a page becomes its name. The reference is generated from the
code: commands from the parser, REST from the OpenAPI description, channels from telemetry, the API from docstrings.
"""

import argparse
import os
import re
import sys
import tempfile
from collections.abc import Iterator
from contextlib import redirect_stdout, suppress
from io import StringIO
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parents[1]
sys.path.insert(0, str(ROOT))

#: Page of each Markdown file, by the file's path in the repository.
PAGES = {
    "README.md": "index.md",
    "CHANGELOG.md": "changes.md",
    "CONTRIBUTING.md": "how-to/contribute.md",
    ".github/SECURITY.md": "how-to/security.md",
    "tests/README.md": "how-to/tests.md",
    "core/README.md": "explanations/model.md",
    "station/README.md": "explanations/station.md",
    "station/calibration/README.md": "how-to/calibrate.md",
    "station/design/README.md": "how-to/design.md",
    "station/devices/README.md": "how-to/devices.md",
    "station/docs/engineer.md": "tutorials/engineer.md",
    "station/docs/examples/README.md": "tutorials/examples.md",
    "station/docs/glossary.md": "reference/glossary.md",
    "station/docs/reviewer.md": "tutorials/reviewer.md",
    "station/docs/student.md": "tutorials/student.md",
    "station/docs/decisions.md": "explanations/decisions.md",
    "station/experiments/README.md": "how-to/experiments.md",
    "station/gym/README.md": "how-to/gym.md",
    "station/lab/README.md": "explanations/lab.md",
    "station/machine/README.md": "how-to/machine.md",
    "station/recording/README.md": "how-to/recordings.md",
    "station/report/README.md": "how-to/reports.md",
    "web/README.md": "explanations/web.md",
    "web/gateway/README.md": "how-to/gateway.md",
}
#: Modules of each page of the Python API: files of the repository.
API = {
    "robot": ("The robot, and the limits of its joints.", ["core/robot/[!_]*.py", "core/errors.py"]),
    "model": ("The loaded model: shape, Jacobian and compliance.", ["core/model/[!_]*.py"]),
    "control": ("The control law; `step` is one tick.", ["core/control/[!_]*.py"]),
    "calibration": ("Fits of frames, sensors and tubes.", ["core/calibration/[!_]*.py"]),
    "client": ("The client of a running station, for scripts.", ["station/client.py", "station/solve_many.py"]),
    "devices": ("The contract of drivers.", ["station/devices/interfaces.py"]),
}
LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)#\s]*)(#[^)\s]*)?\)")
#: Pattern of a line that only links to a source file; the site shows the file's text instead.
SOURCE = re.compile(r"^\[`[\w.]+`\]\((\S+\.py)\)$", re.MULTILINE)
KEYS = "reference/files.md"  #: page with the output of `ctr-station keys`
#: Folder of `python -m tests.tools.gallery build/gallery EXPERIMENT ...`; if it exists, the site has its pages.
GALLERY = ROOT / "build" / "gallery"
REPLAY = "**[Play a recorded run of Fig. 10 in 3D](gallery/fig10/replay.html), or see [all runs](gallery/index.html).**"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages of the repository's Markdown files, their pictures, and the generated reference."""
    pages = {f"station/docs/pages/{file.src_uri}": file.src_uri for file in files if file.src_uri[-3:] == ".md"} | PAGES
    pictures: dict[str, str] = {}
    for path, uri in pages.items():
        text = _linked((ROOT / path).read_text(encoding="utf-8"), Path(path).parent.as_posix(), uri, pages, pictures)
        if uri == "index.md" and GALLERY.exists():
            text = text.replace("\n\n", f"\n\n{REPLAY}\n\n", 1)
        if (old := files.get_file_from_path(uri)) is not None:
            files.remove(old)
        files.append(File.generated(config, uri, content=text))
    for path, uri in pictures.items():
        files.append(File.generated(config, uri, abs_src_path=str(ROOT / path)))
    for path in (*GALLERY.glob("*.html"), *GALLERY.glob("*/*.*")):
        uri = f"gallery/{path.relative_to(GALLERY).as_posix()}"
        files.append(File.generated(config, uri, abs_src_path=str(path)))
    for uri, text in _reference():
        files.append(File.generated(config, uri, content=_linked(text, "station", uri, pages, pictures)))
    return files


def _linked(text: str, folder: str, uri: str, pages: dict[str, str], pictures: dict[str, str]) -> str:
    """Return a file's text with links to pages instead of files."""

    def link(found: re.Match[str]) -> str:
        picture, name, target, heading = found[1], found[2], found[3], found[4] or ""
        if not target or re.match(r"[a-z]+:", target):
            return found[0]
        path = os.path.normpath(f"{folder}/{target}")
        if not (ROOT / path).exists():
            raise FileNotFoundError(f"{folder} links to {target}, which does not exist")
        if picture:
            pictures[path] = f"pictures/{path.replace('/', '-')}"
            shown = os.path.relpath(pictures[path], Path(uri).parent)
            return f"[![{name}]({shown})]({shown})"  # a click shows the picture in its full size
        if path in pages:
            return f"[{name}]({os.path.relpath(pages[path], Path(uri).parent)}{heading})"
        return name if "`" in name else f"{name} (`{path}`)"

    text = SOURCE.sub(lambda found: f"```python\n{(ROOT / folder / found[1]).read_text(encoding='utf-8')}```", text)
    keys = f"[`ctr-station keys`]({os.path.relpath(KEYS, Path(uri).parent)})"
    parts = re.split(r"(^```.*?^```$)", text, flags=re.DOTALL | re.MULTILINE)
    return "".join(
        part if part.startswith("```") else LINK.sub(link, part).replace("`ctr-station keys`", keys) for part in parts
    )


def _reference() -> Iterator[tuple[str, str]]:
    from station.cli.config_reference import reference_page
    from station.devices.driver_check.requirements import requirements_table

    yield KEYS, reference_page()
    yield "reference/commands.md", "\n".join(_commands())
    yield "reference/channels.md", "\n".join(_channels())
    yield "reference/rest.md", "\n".join(_rest())
    yield "reference/requirements.md", f"# Requirements of drivers\n\n{requirements_table()}"
    for name, (text, places) in API.items():
        found = (path for place in places for path in sorted(ROOT.glob(place)))
        modules = [path.relative_to(ROOT).with_suffix("").as_posix().replace("/", ".") for path in found]
        listed = "\n\n".join(f"::: {each}" for each in modules)
        yield f"reference/api/{name}.md", f"# {name.capitalize()}\n\n{text}\n\n{listed}"


def _cell(text: object) -> str:
    return " ".join(str(text).split()).replace("|", "\\|").replace("<", "&lt;")


def _commands() -> Iterator[str]:
    """Yield the page of all commands, from the parser of `ctr-station`."""
    from station.cli.main import parser as command_line
    from web.cli import main

    top, commands = command_line()
    yield f"# Commands\n\n{top.description} Every command also has `--data` and `--help`.\n"
    with redirect_stdout(StringIO()) as serve, suppress(SystemExit):
        main(["serve", "--help"])  # `web` adds this command to the parser
    yield f"\n## serve\n\n```text\n{serve.getvalue()}```\n"
    helps = {action.dest: action.help or "" for action in commands._choices_actions}
    for name, parser in sorted(commands.choices.items()):
        yield f"\n## {name}\n\n{helps.get(name, '')}\n"
        yield from _options(parser)


def _options(parser: argparse.ArgumentParser) -> Iterator[str]:
    nested = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    shown = [each for each in parser._actions if each.dest not in ("help", "data") and each not in nested]
    if shown:
        yield "| argument | meaning |\n|---|---|"
    for action in shown:
        value = action.metavar or ("" if action.nargs == 0 else "\\|".join(map(str, action.choices or [action.dest])))
        value = " ".join(value) if isinstance(value, tuple) else value
        yield f"| `{' '.join([', '.join(action.option_strings), value]).strip()}` | {_cell(action.help or '')} |"
    for each in nested:
        for name, parser_of in each.choices.items():
            yield f"\n### {parser.prog.split()[-1]} {name}\n"
            yield from _options(parser_of)


#: Section of the page of the channels; the only description of null, -1 and repeated values.
UNKNOWN_VALUES = """
## Values that are not measured now

A row always has every channel. A value is unknown while stages are homed, while a device is silent, or if the bench
does not have the device. The outputs of the station report an unknown value as follows:

| output | unknown value |
|---|---|
| recording, export, Foxglove `/telemetry`, LSL | the last known value remains |
| `GET /api/status`, WebSocket `/api/telemetry` | `null` |
| OpenIGTLink, ROS 2, drawings | omitted |
| page | a gap in a plot, a dash in the strip above the tabs |

These channels show which values of a row are known:

| channel | value | meaning |
|---|---|---|
| `trouble.*` | -1 | the bench does not have this device, so the device's channels have no meaning |
| | 0 | the device has no fault |
| | {severities} | the fault's severity; from HOLD on the device's channels are unknown |
| `estimates_frozen` | 1 | the controller had no new measurements: the estimates are those of an earlier row |
| `tip_new`, `target_new` | 0 | no new tracker frame; the values of the last frame remain |
| `truth_known` | 0 | there is no virtual lab: `tip_true`, `force_true` and the other true channels are 0 |
| `direction_*` | 0, 0, 0 | the direction is neither measured nor controlled |
| `request_kind` | 0, 1, 2 | no streamed setpoint, a position, a velocity |

Without force sensors the channels `force`, `force_filtered` and `force_variance` have the force from the deflection.

## Numbers of states and phases

| channel | numbers |
|---|---|
| `state` | {states} |
| `phase` | {phases} |

## All channels
"""


def _channels() -> Iterator[str]:
    """Yield the page of the channels of the robot `paper`, from telemetry."""
    from station.config.robots import load_robot
    from station.control.states import State
    from station.control.task import Phase
    from station.control.telemetry import FIELDS, Channels
    from station.devices.interfaces import Severity

    channels = Channels(load_robot("paper").robot())
    numbers = {"severities": Severity, "states": State, "phases": Phase}
    yield (
        "# Channels\n\nEach tick of the control loop has one row with these channels, for the robot `paper`. A robot "
        "with other joints or tubes has their names instead. [Recordings](recording/README.md) describe the file, "
        "the [glossary](docs/glossary.md) the terms.\n"
    )
    yield UNKNOWN_VALUES.format(
        **{name: ", ".join(f"{each.value} {each.name}" for each in kind) for name, kind in numbers.items()}
    )
    yield "| group | unit | columns | meaning |\n|---|---|---|---|"
    for field in FIELDS:
        own = [each for each in channels.all if each.name.rsplit(".", 1)[0] == field.name]
        columns = ", ".join(f"`{each.name.removeprefix(field.name + '.')}`" for each in own if each.name != field.name)
        units = ", ".join(dict.fromkeys(each.unit for each in own if each.unit))
        yield f"| `{field.name}` | {units} | {columns} | {field.meaning} |"


def _rest() -> Iterator[str]:
    """Yield the page of all REST requests, from the OpenAPI description of an application without processes."""
    from station.control.states import State
    from station.service.commands import COMMANDS
    from tests.harness.web_app import web_app

    with tempfile.TemporaryDirectory() as folder, web_app(Path(folder)) as client:
        described = client.get("/api/openapi.json").json()
    yield (
        "# REST\n\nA running station serves this description with a form for every request at `/api/docs`. Changes "
        "need the operator's lease; STOP never does ([server](../web/README.md)).\n"
    )
    yield "## Commands\n\n| request | accepted in | moves the robot | what it does |\n|---|---|---|---|"
    for command in COMMANDS:
        states = "every state" if set(command.states) == set(State) else ", ".join(each.name for each in command.states)
        text = _cell((command.__doc__ or "").split("\n\n")[0])
        yield f"| {command.method} {command.path()} | {states} | {'yes' if command.moves else ''} | {text} |"
    for path, methods in described["paths"].items():
        for method, call in methods.items():
            yield f"\n## {method.upper()} {path}\n\n{_cell(call.get('description') or call.get('summary', ''))}\n"
            yield from _fields(call, described["components"]["schemas"])


def _fields(call: dict[str, Any], schemas: dict[str, Any]) -> Iterator[str]:
    rows = [(each["name"], each.get("schema", {}), each.get("required")) for each in call.get("parameters", [])]
    body = call.get("requestBody", {}).get("content", {}).get("application/json", {}).get("schema", {})
    body = schemas.get(body.get("$ref", "").rsplit("/", 1)[-1], body)
    needed = body.get("required", [])
    rows += [(name, field, name in needed) for name, field in body.get("properties", {}).items()]
    if rows:
        yield "| field | meaning |\n|---|---|"
    for name, field, required in rows:
        yield f"| `{name}`{' (required)' if required else ''} | {_cell(field.get('description', ''))} |"
