"""Compare numbers of the project with those of `tests/ratchet.toml`, which may only fall.

`python -m tests.tools.ratchet [PART=SECONDS ...]`

The numbers are lines of product and tests, and what makes tests unsteady or texts unclear. A larger number than in the
file is an error: a commit that needs more raises it, with the reason in its body, and a commit that needs less lowers
it. More seconds of a part of CI only give a warning, because computers differ and are busy.
"""

import re
import subprocess
import sys
import tomllib
from collections.abc import Mapping, Sequence
from datetime import date, timedelta
from typing import Any

from tests.harness.root import ROOT

LIMITS, UNSTEADY = ROOT / "tests" / "ratchet.toml", ROOT / "tests" / "unsteady.toml"
SLACK = 1.5  #: seconds may exceed those of the file by this factor without a warning
LONGEST = timedelta(days=14)  #: time that an unsteady test has until it is mended
CODE, TEXTS = (".py", ".js", ".css", ".html"), (".py", ".js", ".html", ".toml", ".md")
#: Counted expressions, by name: the start of the paths in which they are counted, endings of the files, and expression.
COUNTED: Mapping[str, tuple[tuple[str, ...], tuple[str, ...], str]] = {
    "sleeps": (("tests/live/",), (".py",), r"\b(time\.sleep|wait_for_timeout)\("),
    "single_reads": (("tests/live/",), (".py",), r"\.(input_value|text_content|inner_text|is_visible)\(\)"),
    "own_timeouts": (("tests/live/",), (".py",), r"\btimeout=[\d.]+"),
    "live_tests": (("tests/live/",), (".py",), r"^(async )?def test_|^    def test_"),
    "page_tests": (("tests/live/browser/",), (".py",), r"^def test_|^    def test_"),
    # `glossary.md` has the right words.
    "misused_words": (
        ("core/", "station/", "web/", "README", "CONTRIBUTING", "CHANGELOG"), TEXTS,
        r"(?i)(?<!\.)\b(told|tells?|anew|nobody|somebody|whoever|anybody|askew|hardly|heard|beside|wanted|says|said)\b",
    ),
}  # fmt: skip


def counts(files: Sequence[str]) -> Mapping[str, Mapping[str, int]]:
    """Return all numbers of files of the project, given as paths relative to its root."""
    lines, found = {"product": 0, "tests": 0}, dict.fromkeys(COUNTED, 0)
    for name in files:
        if not (name.endswith((*CODE, *TEXTS)) and (ROOT / name).is_file()):
            continue
        text = (ROOT / name).read_text(encoding="utf-8")
        if name.endswith(CODE):
            lines["tests" if name.startswith("tests/") else "product"] += text.count("\n")
        for what, (starts, ends, expression) in COUNTED.items():
            if name.startswith(starts) and name.endswith(ends):
                found[what] += len(re.findall(expression, text, re.MULTILINE))
    return {"lines": lines, "counts": found}


def compared(limits: Mapping[str, Mapping[str, int]], found: Mapping[str, Mapping[str, int]]) -> tuple[list[str], bool]:
    """Return one text for each number, and whether a number other than seconds exceeds its limit."""
    texts, failed = list[str](), False
    for kind, numbers in found.items():
        for name, number in numbers.items():
            limit = limits[kind].get(name)
            if limit is None:
                word = "no limit"
            elif kind != "seconds" and number > limit:
                word, failed = f"MORE than {limit}: remove some, or raise the limit in {LIMITS.name} and say why", True
            elif kind == "seconds" and number > SLACK * limit:
                word = f"warning: usually {limit}"
            else:
                word = f"usually {limit}" if kind == "seconds" else f"limit {limit}"
            texts.append(f"{kind} of {name}: {number} ({word})")
    return texts, failed


def overdue(entries: Sequence[Mapping[str, Any]], today: date) -> list[str]:
    """Return a text for each entry of `tests/unsteady.toml` that lacks a key, names no test, or is too old."""
    texts = list[str]()
    for entry in entries:
        lacks = {"test", "first_seen", "cause", "ends_by"} - set(entry)
        if lacks:
            texts.append(f"{entry}: lacks {', '.join(sorted(lacks))}")
        elif not (ROOT / entry["test"].partition("::")[0]).is_file():
            texts.append(f"{entry['test']}: there is no such test; remove the entry")
        elif today > entry["first_seen"] + LONGEST:
            texts.append(f"{entry['test']}: unsteady since {entry['first_seen']}, at most {LONGEST.days} days: mend it")
    return texts


def main(arguments: Sequence[str]) -> int:
    """Print all numbers; return 1 if one is too large, or an unsteady test is overdue."""
    files = subprocess.run(("git", "ls-files"), cwd=ROOT, check=True, capture_output=True, text=True).stdout.split("\n")
    entries = tomllib.loads(UNSTEADY.read_text(encoding="utf-8")).get("unsteady", [])
    numbers = {kind: dict(found) for kind, found in counts(files).items()}
    numbers["counts"]["unsteady"] = len(entries)
    numbers["seconds"] = {part: int(number) for part, number in (text.split("=") for text in arguments)}
    texts, failed = compared(tomllib.loads(LIMITS.read_text(encoding="utf-8")), numbers)
    late = overdue(entries, date.today())
    print("\n".join((*texts, *late)))  # noqa: T201
    return int(failed or bool(late))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
