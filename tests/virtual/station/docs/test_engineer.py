"""The examples of the guide engineer.md run exactly as the page shows them."""

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

PAGE = (Path(station.__file__).parent / "docs" / "engineer.md").read_text(encoding="utf-8")


def block(language: str, holding: str) -> str:
    """Return the code block of the page that contains the text `holding`."""
    (found,) = [text for text in re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL) if holding in text]
    return found


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the working folder of a user who follows the page."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


def printed(said: str) -> None:
    """Check that a script's output equals the output on the page, except for the last digits."""
    number = r"(?<![\w.])\d+\.\d+"
    shown = next(text for text in re.findall(r"```text\n(.*?)```", PAGE, re.DOTALL) if text.split(":")[0] in said)
    assert re.sub(number, "#", said).split() == re.sub(number, "#", shown).split()
    assert [*map(float, re.findall(number, said))] == pytest.approx([*map(float, re.findall(number, shown))], rel=0.05)


def test_custom_controller_of_the_guide_is_selected_by_name_and_runs(folder: Path, monkeypatch, capsys):
    monkeypatch.setitem(STRATEGIES, "gentle", STRATEGIES["dual_layer"])  # undone after the test
    (folder / "gentle.py").write_text(block("python", "class Gentle"), encoding="utf-8")
    (folder / "hurry.toml").write_text(block("toml", "gently"), encoding="utf-8")
    (folder / "try_gentle.py").write_text(block("python", "importing it registers"), encoding="utf-8")
    runpy.run_path("try_gentle.py")
    printed(capsys.readouterr().out)


@pytest.mark.parametrize(("module", "script"), [("class Roll", "try_roll"), ("class Plane", "try_plane")])
def test_custom_task_and_limit_of_the_guide_have_the_results_of_the_guide(
    folder: Path, monkeypatch, capsys, module: str, script: str
) -> None:
    monkeypatch.setitem(STRATEGIES, "gentle", STRATEGIES["dual_layer"])  # undone after the test
    name = script.removeprefix("try_")
    (folder / "gentle.py").write_text(block("python", "class Gentle"), encoding="utf-8")
    (folder / "hurry.toml").write_text(block("toml", "gently"), encoding="utf-8")
    (folder / f"{name}.py").write_text(block("python", module), encoding="utf-8")
    (folder / f"{script}.py").write_text(block("python", f"from {name} import"), encoding="utf-8")
    runpy.run_path(f"{script}.py")
    printed(capsys.readouterr().out)


def with_the_pages_load(folder: Path) -> object:
    """Return the module `loads.py` with the custom load of the page."""
    text = Path(loads.__file__).read_text(encoding="utf-8")
    change = block("diff", "SawLoad").splitlines()
    before, after = ("\n".join(line[1:] for line in change if line[0] != sign) for sign in "+-")
    assert text.count(before) == 1
    assert text.count("\nLoad = Annotated[") == 1
    text = text.replace(before, after).replace("\nLoad = ", f"\n{block('python', 'class SawLoad')}\n\nLoad = ")
    path = folder / "changed_loads.py"
    path.write_text(text, encoding="utf-8")
    return importlib.import_module("changed_loads")


def test_custom_load_of_the_guide_is_accepted_in_an_experiment_and_has_its_force(folder: Path):
    changed = with_the_pages_load(folder)
    known = TypeAdapter(changed.Load)
    table = tomllib.loads(block("toml", '"saw"'))["load"]
    load = known.validate_python(table)
    assert known.validate_python({"kind": "constant", "magnitude": 0.1}).magnitude == 0.1
    with pytest.raises(ValidationError, match="less than or equal to 20"):
        known.validate_python(table | {"peak": 30.0})

    (folder / "saw.toml").write_text(re.sub(r"\[load\].*", "", block("toml", '"saw"'), flags=re.DOTALL))
    (case,) = load_experiment("saw.toml").cases
    recording = a_run(case._replace(file=case.file.model_copy(update={"load": load, "duration": 2.2})))
    pull = recording.channels.of(recording.rows, "force_true")[:, 0]
    time = recording.channels.of(recording.rows, "time")[:, 0]
    assert recording.completed
    grows = time < 1.99
    assert pull[grows] == pytest.approx(0.15 * time[grows], abs=1e-3)
    assert pull[time > 2.01] == pytest.approx(0.15 * (time[time > 2.01] - 2.0), abs=1e-3)


def test_custom_device_of_the_guide_is_found_by_a_station_file_and_runs_in_the_lab(folder: Path, capsys):
    (folder / "my_bench.py").write_text(block("python", "class Unloaded"), encoding="utf-8")
    project = tomllib.loads(block("toml", "my-bench"))["project"]
    entries = project["entry-points"]["ctr_station.devices"]
    installed = folder / "my_bench-1.0.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: my-bench\nVersion: 1.0\n", encoding="utf-8")
    lines = [f"{name} = {where}" for name, where in entries.items()]
    (installed / "entry_points.txt").write_text("\n".join(["[ctr_station.devices]", *lines]), encoding="utf-8")
    (folder / "bench.toml").write_text(block("toml", 'driver = "unloaded"'), encoding="utf-8")
    bench = load_station(folder / "bench.toml").bench()
    assert bench.devices is not None

    (folder / "try_unloaded.py").write_text(block("python", "import open_sensors"), encoding="utf-8")
    runpy.run_path("try_unloaded.py")
    printed(capsys.readouterr().out)
