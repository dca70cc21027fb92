"""The command `keys`: print a reference of every key of every configuration file, from the models that check them."""

import argparse
import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from station.config import strict

WORKED_EXAMPLES = Path(strict.__file__).parent / "worked"
HEADING = """# Configuration files

Robots, stations, virtual labs, experiments and studies are TOML files. They use SI units (m, rad, s, N). The world
frame has x down and z along the straight tubes. A key that is not listed here is rejected with its line, and so is a
value out of its range. `ctr-station keys` prints this page from the models that check the files. Files without
`format` are read as format 1. Files with a newer format than this page are rejected.

* `ctr-station serve --config station.toml` starts a station. Paths in this file are relative to its folder.
* `ctr-station run FILE.toml` runs an experiment. The panel's tab *Run* lists the experiments in `[experiments] folder`.
  For a file that is not a valid experiment it shows the reason.
* `ctr-station design FILE.toml` runs a study; [design](design/README.md) describes the results.
* A preset can be named instead of a file:
"""
CASES_TEXT = """
An experiment's file may also have these tables:

* `[cases.NAME]` defines a case and changes any of these keys for it.
* `[cross.AXIS.CHOICE]` defines a case for every combination of choices.
* `[paper.NAME]` has reference numbers: `max_abs_error_mm` by axis, `model_error_mm` by model.

Without cases the experiment has one case with the name of the file.
"""
CALIBRATIONS_TEXT = """
`ctr-station calibrate` writes this file and the next into a new folder, together with a `robot.toml` and a
`described.toml` in the format of a robot's file. `robot.toml` has the calibrated tubes; only its stiffness, Poisson's
ratio, lengths and curvatures are used, and all other keys come from the robot's file. `described.toml` is the
robot's file before the calibration. If its tubes, its base or the tubes of its joints have changed since, the
calibration is refused. The key `calibration` of a station or an experiment names the folder.
"""
DEVICES_TEXT = """
The sections *Driver* list the options of each built-in driver; [devices](devices/README.md) has an example of a bench.
"""

Schema = Mapping[str, Any]


def add(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add the command `keys` to the parser."""
    keys = commands.add_parser("keys", help="every key of robot, station, lab, experiment and study files, as Markdown")
    keys.set_defaults(command=_keys)


def _keys(parsed: argparse.Namespace) -> int:  # noqa: ARG001 - it takes no options
    print(reference_page(), end="")  # noqa: T201
    return 0


def reference_page() -> str:
    """Return the reference page as Markdown."""
    from station.config.robots import RobotFile
    from station.control.bench_calibration import LatencyFile, RegistrationFile, SensorsFile, ViewsFile
    from station.control.residual_file import ResidualFile
    from station.design.study import StudyFile
    from station.devices.ati.netft import NetftFile
    from station.devices.ati.nidaq import NidaqFile
    from station.devices.aurora.tracker import AuroraFile
    from station.devices.cia402.setup import Cia402File
    from station.devices.gcode.setup import GcodeFile
    from station.devices.stereo.tracker import StereoFile
    from station.devices.zaber.setup import ZaberFile
    from station.devices.zaber_ascii.setup import AsciiFile
    from station.experiments.experiment import CaseFile
    from station.lab.config import LabConfig
    from station.service.station_file import StationFile

    documented: set[str] = set()
    presets = (f"    * {kind}: {', '.join(strict.preset_names(kind))}" for kind in ("robots", "labs", "experiments"))
    parts = [HEADING + "\n".join(presets), *_worked()]
    for title, model, more in (
        ("Robot", RobotFile, ""),
        ("Station", StationFile, DEVICES_TEXT),
        ("Driver zaber", ZaberFile, ""),
        ("Driver zaber_ascii", AsciiFile, ""),
        ("Driver cia402", Cia402File, ""),
        ("Driver gcode", GcodeFile, ""),
        ("Driver aurora", AuroraFile, ""),
        ("Driver stereo", StereoFile, ""),
        ("Driver netft", NetftFile, ""),
        ("Driver nidaq", NidaqFile, ""),
        ("Virtual lab", LabConfig, ""),
        ("Experiment", CaseFile, CASES_TEXT),
        ("Calibration: registration.toml", RegistrationFile, CALIBRATIONS_TEXT),
        ("Calibration: sensors.toml", SensorsFile, ""),
        ("Calibration: residual.toml", ResidualFile, ""),
        ("Calibration: latency.toml", LatencyFile, ""),
        ("Calibration: cameras.toml", ViewsFile, ""),
        ("Study", StudyFile, ""),
    ):
        schema = TypeAdapter(model).json_schema()
        definitions = schema.pop("$defs", {})
        parts += [f"\n## {title}\n", _sentence(schema), more, *_table(schema, definitions)]
        for name in _nested_models(schema, definitions):
            if name not in documented:
                documented.add(name)
                found = definitions[name]
                parts += [f"\n### {_heading(name)}\n", _sentence(found), *_table(found, definitions)]
    return "\n".join(part.strip("\n") if part.startswith("|") else part for part in parts if part).rstrip() + "\n"


def _worked() -> Iterator[str]:
    yield "\n## A complete example: robot, lab, experiment and station\n"
    for path in ("robot.toml", "lab.toml", "experiments/square.toml", "station.toml"):
        yield f"`{path}`\n\n```toml\n{(WORKED_EXAMPLES / path).read_text(encoding='utf-8')}```\n"


def _table(schema: Schema, definitions: Schema) -> Iterator[str]:
    """Yield the lines of a Markdown table with one row for each key."""
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
    """Return the type and range of a key's value as text of a table cell."""
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
            of = next(iter(field.get("patternProperties", {}).values()), field.get("additionalProperties"))
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
        return ", ".join(f"`{key} = {_toml(value)}`" for key, value in changed.items()) or "its defaults"
    return f"`{_toml(default)}`"


def _toml(value: Any) -> str:
    """Return a value in TOML syntax."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_toml(one)}" for key, one in value.items()) + " }" if value else "{}"
    if isinstance(value, list):
        return f"[{', '.join(_toml(one) for one in value)}]"
    return json.dumps(value, ensure_ascii=False)


def _heading(name: str) -> str:
    """Return a model's name as a heading: `Circle motion` of CircleMotion, `Tube` of TubeFile."""
    return re.sub("(?<!^)(?=[A-Z])", " ", re.sub("(File|Config)$", "", name)).capitalize()


def _sentence(schema: Schema) -> str:
    return " ".join(schema.get("description", "").split())


def _nested_models(schema: Schema, definitions: Schema) -> list[str]:
    """Return the names of the nested tables in their order of appearance."""
    found: list[str] = []

    def visit(part: Any) -> None:
        if isinstance(part, Mapping):
            if (name := str(part.get("$ref", "")).rsplit("/", 1)[-1]) and name not in found:
                found.append(name)
                visit(definitions[name])
            for key, one in part.items():
                if key not in ("discriminator", "default"):
                    visit(one)
        elif isinstance(part, list):
            for one in part:
                visit(one)

    visit(schema)
    return found
