"""The examples of the pages `how-to/add-a-*.md` run exactly as the pages show them."""

import importlib
import importlib.util
import re
import runpy
import tomllib
from pathlib import Path

import pytest
from pydantic import TypeAdapter, ValidationError

import station
from core.control.controllers import STRATEGIES
from station.config import loads
from station.experiments.experiment import load_experiment
from station.service.station_file import load_station
from tests.harness.cases import a_run

PAGES = Path(station.__file__).parent / "docs" / "pages" / "how-to"


def page(name: str) -> str:
    """Return the text of the page `add-a-NAME.md`."""
    return (PAGES / f"add-a-{name}.md").read_text(encoding="utf-8")


def files(name: str) -> dict[str, str]:
    """Return the files of a page: the sentence above a code block names the file, and ends with a colon."""
    file = r"`([\w./]+\.(?:py|toml))`"
    named = re.findall(rf"{file}(?:(?!\n\n|{file}).)*:\n\n```\w+\n(.*?)```", page(name), re.DOTALL)
    named = [(path, text) for path, _, text in named]
    assert len(named) == len(dict(named)) == len(re.findall(r"^```(?:python|toml)$", page(name), re.MULTILINE))
    return dict(named)


def block(name: str, language: str) -> str:
    """Return the only code block of a page in a language."""
    (found,) = re.findall(rf"^```{language}\n(.*?)^```", page(name), re.DOTALL | re.MULTILINE)
    return found


def write(folder: Path, name: str) -> None:
    """Write the files of a page into a folder."""
    for file, text in files(name).items():
        (folder / file).write_text(text, encoding="utf-8")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the working folder of a user who follows the page."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


def check_output(name: str, output: str) -> None:
    """Check that a script's output equals the output on the page, except for the last digits."""
    number, shown = r"(?<![\w.])\d+\.\d+", block(name, "text")
    assert re.sub(number, "#", output).split() == re.sub(number, "#", shown).split()
    printed, expected = ([*map(float, re.findall(number, text))] for text in (output, shown))
    assert printed == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize(
    ("name", "script"), [("controller", "try_gentle.py"), ("control-task", "try_roll.py"), ("limit", "try_plane.py")]
)
def test_script_of_an_example_prints_the_output_of_its_page(folder: Path, monkeypatch, capsys, name: str, script: str):
    monkeypatch.setitem(STRATEGIES, "gentle", STRATEGIES["dual_layer"])  # undone after the test
    write(folder, name)
    runpy.run_path(script)
    check_output(name, capsys.readouterr().out)


def with_the_pages_load(folder: Path) -> object:
    """Return the module `loads.py` with the custom load of the page."""
    text = Path(loads.__file__).read_text(encoding="utf-8")
    change = block("load", "diff").splitlines()
    before, after = ("\n".join(line[1:] for line in change if line[0] != sign) for sign in "+-")
    assert text.count(before) == 1
    assert text.count("\nLoad = Annotated[") == 1
    text = text.replace(before, after).replace("\nLoad = ", f"\n{files('load')['station/config/loads.py']}\n\nLoad = ")
    path = folder / "changed_loads.py"
    path.write_text(text, encoding="utf-8")
    return importlib.import_module("changed_loads")


def test_custom_load_of_the_guide_is_accepted_in_an_experiment_and_has_its_force(folder: Path):
    changed = with_the_pages_load(folder)
    known = TypeAdapter(changed.Load)
    table = tomllib.loads(files("load")["saw.toml"])["load"]
    load = known.validate_python(table)
    assert known.validate_python({"kind": "constant", "magnitude": 0.1}).magnitude == 0.1
    with pytest.raises(ValidationError, match="less than or equal to 20"):
        known.validate_python(table | {"peak": 30.0})

    (folder / "saw.toml").write_text(re.sub(r"\[load\].*", "", files("load")["saw.toml"], flags=re.DOTALL))
    (case,) = load_experiment("saw.toml").cases
    recording = a_run(case._replace(file=case.file.model_copy(update={"load": load, "duration": 2.2})))
    pull = recording.channels.of(recording.rows, "force_true")[:, 0]
    time = recording.channels.of(recording.rows, "time")[:, 0]
    assert recording.completed
    grows = time < 1.99
    assert pull[grows] == pytest.approx(0.15 * time[grows], abs=1e-3)
    assert pull[time > 2.01] == pytest.approx(0.15 * (time[time > 2.01] - 2.0), abs=1e-3)


def test_custom_device_of_the_guide_is_found_by_a_station_file_and_runs_in_the_lab(folder: Path, capsys):
    write(folder, "sensor-driver")
    project = tomllib.loads(files("sensor-driver")["pyproject.toml"])["project"]
    entries = project["entry-points"]["ctr_station.devices"]
    installed = folder / "my_bench-1.0.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: my-bench\nVersion: 1.0\n", encoding="utf-8")
    lines = [f"{name} = {where}" for name, where in entries.items()]
    (installed / "entry_points.txt").write_text("\n".join(["[ctr_station.devices]", *lines]), encoding="utf-8")
    bench = load_station(folder / "bench.toml").bench()
    assert bench.devices is not None
    runpy.run_path("try_unloaded.py")
    check_output("sensor-driver", capsys.readouterr().out)
