"""The examples of the page `how-to/control-strategies.md` run exactly as the page shows them."""

import re
import runpy
import tomllib
from pathlib import Path

import pytest

import station
from station.config.strict import ConfigError
from station.experiments.experiment import load_experiment
from tests.harness.cases import a_run
from tests.harness.entry_points import install_entry_points

PAGE = (Path(station.__file__).parent / "docs/pages/how-to/control-strategies.md").read_text(encoding="utf-8")


def files() -> dict[str, str]:
    """Return the files of the page: the sentence above a code block names the file, and ends with a colon."""
    file = r"`([\w./]+\.(?:py|toml))`"
    named = re.findall(rf"{file}(?:(?!\n\n|{file}).)*:\n\n```\w+\n(.*?)```", PAGE, re.DOTALL)
    named = [(path, text) for path, _, text in named]
    assert len(named) == len(dict(named)) == len(re.findall(r"^```(?:python|toml)$", PAGE, re.MULTILINE))
    return dict(named)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder of a user who has written the files of the page and installed its package."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    for file, text in files().items():
        (tmp_path / file).write_text(text, encoding="utf-8")
    project = tomllib.loads(files()["pyproject.toml"])["project"]
    install_entry_points(tmp_path, project["entry-points"], project["name"])
    return tmp_path


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("script", ["try_loop.py", "try_roll.py", "try_plane.py"])
def test_script_of_an_example_prints_the_output_of_the_page_except_for_the_last_digits(capsys, script: str):
    runpy.run_path(script)
    output = capsys.readouterr().out
    (shown,) = re.findall(rf"`python {script}` prints:\n\n```text\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    number = r"(?<![\w.])\d+\.\d+"
    assert re.sub(number, "#", output).split() == re.sub(number, "#", shown).split()
    printed, expected = ([*map(float, re.findall(number, text))] for text in (output, shown))
    assert printed == pytest.approx(expected, rel=0.05)


def test_custom_load_of_the_guide_is_accepted_in_an_experiment_and_has_its_force(folder: Path):
    (case,) = load_experiment("saw.toml").cases
    recording = a_run(case._replace(file=case.file.model_copy(update={"duration": 2.2})))
    pull = recording.channels.of(recording.rows, "force_true")[:, 0]
    time = recording.channels.of(recording.rows, "time")[:, 0]
    assert recording.completed
    grows = time < 1.99
    assert pull[grows] == pytest.approx(0.15 * time[grows], abs=1e-3)
    assert pull[time > 2.01] == pytest.approx(0.15 * (time[time > 2.01] - 2.0), abs=1e-3)

    (folder / "saw.toml").write_text(files()["saw.toml"].replace("peak = 0.3", "peak = 30.0"), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"30\.0.*expected a peak of 0 \.\.\. 1 N"):
        load_experiment("saw.toml")
