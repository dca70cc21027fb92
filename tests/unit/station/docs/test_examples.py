"""The overview of the example packages is complete; `tests/thorough` installs and tests each package."""

from tests.harness.root import ROOT

EXAMPLES = ROOT / "station" / "docs" / "examples"
FOLDERS = sorted(path.parent for path in EXAMPLES.glob("*/pyproject.toml"))


def test_overview_of_the_examples_names_every_folder():
    text = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    assert [folder.name for folder in FOLDERS if f"| `{folder.name}` |" not in text] == []
    assert len(FOLDERS) >= 5
