"""The command `keys`: every key of every file that a person may write, from the models that check them.

`station/FILES.md` is what it prints.
"""

import argparse
import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from station.config import strict

WORKED = Path(strict.__file__).parent / "worked"
TOP = """# Files of one's own

Robots, stations, virtual labs, experiments and studies are TOML files: SI units (m, rad, s, N), world frame with x
down and z along the straight tubes. A key that is not listed here is refused with its line; so is a value out of its
range. The page is printed by `ctr-station keys` from the models that check the files. `format` tells which page a file
was written after: without it that is 1, and one of a later format than this page's is refused.

* `ctr-station serve --config station.toml` starts a station; the files that it names stand beside it.
* `ctr-station run FILE.toml` carries out an experiment; the names of those in `[experiments] folder` are listed in
  the panel's tab *Run*, where a file that is no experiment is shown with its reason.
* `ctr-station design FILE.toml` carries out a study; [design](design/README.md) says what comes of it.
* Name a preset instead of a file to begin with: robots `paper`, `balanced_pair`, `three_tubes`, `nylon`; labs `gentle`,
  `realistic`, `distorted`, `uncalibrated`, `ideal`.
"""
CASES = """
Besides, an experiment's file has `[cases.NAME]`, tables that change any of these keys, one for each case; with
`[cross.AXIS.CHOICE]` there is a case for every combination of choices; and `[paper.NAME]` holds numbers to compare
with: `max_abs_error_mm` by axis, `model_error_mm` by model. Without any of them there is one case, of the file's name.
"""
CALIBRATIONS = """
`ctr-station calibrate` writes this file and the next into a folder of its own, with a `robot.toml` that is a robot's
file as above; `calibration` of a station or an experiment names the folder.
"""
DEVICES = """
What each driver of `[devices]` has to be told is in [devices](devices/README.md).
"""

Schema = Mapping[str, Any]


def add(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add it."""
    keys = commands.add_parser("keys", help="every key of robot, station, lab, experiment and study files, as Markdown")
    keys.set_defaults(command=_keys)


def _keys(parsed: argparse.Namespace) -> int:  # noqa: ARG001 - it takes no options
    print(page(), end="")  # noqa: T201
    return 0


def page() -> str:
    """The whole page, Markdown."""
    from station.config.robots import RobotFile
    from station.control.known_calibration import RegistrationFile, SensorsFile
    from station.design.study import StudyFile
    from station.experiments.experiment import CaseFile
    from station.lab.config import LabConfig
    from station.service.station_file import StationFile

    told: set[str] = set()
    parts = [TOP, *_worked()]
    for title, model, more in (
        ("Robot", RobotFile, ""),
        ("Station", StationFile, DEVICES),
        ("Virtual lab", LabConfig, ""),
        ("Experiment", CaseFile, CASES),
        ("Calibration: registration.toml", RegistrationFile, CALIBRATIONS),
        ("Calibration: sensors.toml", SensorsFile, ""),
        ("Study", StudyFile, ""),
    ):
        schema = TypeAdapter(model).json_schema()
        definitions = schema.pop("$defs", {})
        parts += [f"\n## {title}\n", _sentence(schema), more, *_table(schema, definitions)]
        for name in _referred(schema, definitions):
            if name not in told:
                told.add(name)
                found = definitions[name]
                parts += [f"\n### {_heading(name)}\n", _sentence(found), *_table(found, definitions)]
    return "\n".join(part.strip("\n") if part.startswith("|") else part for part in parts if part).rstrip() + "\n"


def _worked() -> Iterator[str]:
    yield "\n## A robot with its lab, experiment and station, worked out\n"
    for path in ("robot.toml", "lab.toml", "experiments/square.toml", "station.toml"):
        yield f"`{path}`\n\n```toml\n{(WORKED / path).read_text(encoding='utf-8')}```\n"


def _table(schema: Schema, definitions: Schema) -> Iterator[str]:
    """Its keys, a row each."""
    properties = schema.get("properties", {})
    if not properties:
        return
    yield "\n| key | value | default | |"
    yield "|---|---|---|---|"
    for key, field in properties.items():
        required = key in schema.get("required", ()) or "const" in field
        default = "**required**" if required else _default(field, definitions)
        text = " ".join(field.get("description", "").split()).replace("|", "\\|")
        yield f"| `{key}` | {_value(field)} | {default} | {text} |"


def _value(field: Schema) -> str:
    """What may stand there."""
    if "$ref" in field:
        heading = _heading(field["$ref"].rsplit("/", 1)[-1])
        return f"table [{heading}](#{heading.lower().replace(' ', '-')})"
    if "const" in field:
        return f"`{json.dumps(field['const'])}`"
    if "enum" in field:
        return ", ".join(f"`{json.dumps(one)}`" for one in field["enum"])
    if choices := field.get("oneOf") or field.get("anyOf"):
        return " or ".join(dict.fromkeys(_value(one) for one in choices if one.get("type") != "null"))
    match field.get("type"):
        case "array" if "prefixItems" in field:
            return f"{len(field['prefixItems'])} numbers" + _range(field["prefixItems"][0])
        case "array":
            return f"list of {_value(field['items'])}"
        case "object":
            of = field.get("additionalProperties")
            return f"table by name of {_value(of)}" if isinstance(of, Mapping) and of else "table"
        case "integer":
            return "whole number" + _range(field)
        case "number":
            return "number" + _range(field)
        case "boolean":
            return "true or false"
        case _:
            return "text"


def _range(field: Schema) -> str:
    signs = (("exclusiveMinimum", ">"), ("minimum", "≥"), ("exclusiveMaximum", "<"), ("maximum", "≤"))
    found = [f"{sign} {field[key]:g}" for key, sign in signs if key in field]
    return f" {', '.join(found)}" if found else ""


def _default(field: Schema, definitions: Schema) -> str:
    default = field.get("default")
    if default is None:
        return "none"
    if isinstance(default, Mapping) and "$ref" in field:
        of = definitions[field["$ref"].rsplit("/", 1)[-1]]["properties"]
        changed = {key: value for key, value in default.items() if value != of.get(key, {}).get("default")}
        return ", ".join(f"`{key} = {_toml(value)}`" for key, value in changed.items()) or "its own"
    return f"`{_toml(default)}`"


def _toml(value: Any) -> str:
    """A value as a file has it."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_toml(one)}" for key, one in value.items()) + " }" if value else "{}"
    if isinstance(value, list):
        return f"[{', '.join(_toml(one) for one in value)}]"
    return json.dumps(value, ensure_ascii=False)


def _heading(name: str) -> str:
    """A model's name in words: `Circle motion` of CircleMotion, `Tube` of TubeFile."""
    return re.sub("(?<!^)(?=[A-Z])", " ", re.sub("(File|Config)$", "", name)).capitalize()


def _sentence(schema: Schema) -> str:
    return " ".join(schema.get("description", "").split())


def _referred(schema: Schema, definitions: Schema) -> list[str]:
    """Names of the tables inside it, in the order in which a reader meets them."""
    found: list[str] = []

    def look(part: Any) -> None:
        if isinstance(part, Mapping):
            if (name := str(part.get("$ref", "")).rsplit("/", 1)[-1]) and name not in found:
                found.append(name)
                look(definitions[name])
            for key, one in part.items():
                if key not in ("discriminator", "default"):
                    look(one)
        elif isinstance(part, list):
            for one in part:
                look(one)

    look(schema)
    return found
