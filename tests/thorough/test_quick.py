"""`.ci/quick` accepts the project as it is, and refuses a copy with one defect of each kind."""

import shutil
import subprocess
from pathlib import Path

import pytest

from tests.harness.root import ROOT


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """Return a folder with the files of the project and its environment."""
    folder = tmp_path / "copy"
    names = subprocess.run(
        ("git", "ls-files"), cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout.splitlines()
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, folder / name)
    (folder / ".venv").symlink_to(ROOT / ".venv")
    subprocess.run(("git", "init", "-q"), cwd=folder, check=True)
    return folder


#: File, its text before and after the defect, and the check that refuses it; an empty text is the end of the file.
DEFECTS = {
    "long line in a document": ("README.md", "", f"\nThis line is {'very ' * 30}long.\n", "documents"),
    "dead link in a document": ("README.md", "", "\nSee [nothing](nothing.md).\n", "documents"),
    "import that runs upward": ("core/errors.py", "", "\nimport station.threads as threads\n", "imports"),
    "broken format": ("core/errors.py", "", "\nHALF = (  0.5 )\n", "format"),
    "unused import": ("core/errors.py", "", "\nimport math\n", "lint"),
    "stale generated table": ("tests/golden/expected.json", '"fig10 paper"', '"fig11 paper"', "documents"),
    "stale table of examples": (
        "station/docs/examples/README.md",
        "| `line_stages` |",
        "| `line_stage` |",
        "documents",
    ),
    "more lines of product": ("core/errors.py", "", "\n# more" * 2000 + "\n", "lines"),
    "misused word": ("web/README.md", "", "\nNobody told somebody what anybody heard.\n", "lines"),
}


@pytest.mark.parametrize("defect", DEFECTS)
def test_quick_refuses_a_defect_and_names_its_check(copy: Path, defect: str) -> None:
    name, before, after, check = DEFECTS[defect]
    file = copy / name
    text = file.read_text(encoding="utf-8")
    assert before in text
    file.write_text(text.replace(before, after) if before else text + after, encoding="utf-8")
    assert check in failed(copy)


def test_quick_accepts_the_project_as_it_is(copy: Path) -> None:
    assert failed(copy) == []


def failed(folder: Path) -> list[str]:
    """Return the checks that failed in a folder."""
    subprocess.run(("git", "add", "-A"), cwd=folder, check=True)
    done = subprocess.run(("bash", ".ci/quick"), cwd=folder, capture_output=True, text=True, check=False)
    names = done.stderr.rpartition(".ci/quick: failed:")[2].split() if done.returncode else []
    assert bool(names) == (done.returncode != 0), done.stdout + done.stderr
    return names
