"""Compare lines of product and tests, and seconds of the parts of CI, with those of `tests/ratchet.toml`.

`python -m tests.tools.ratchet [PART=SECONDS ...]`

More lines than in the file are an error: a commit that needs more raises the number, with the reason in its body, and a
commit that needs fewer lowers it. More seconds only give a warning, because computers differ and are busy.
"""

import subprocess
import sys
import tomllib
from collections.abc import Mapping, Sequence

from tests.harness.root import ROOT

LIMITS = ROOT / "tests" / "ratchet.toml"
SLACK = 1.5  #: seconds may exceed those of the file by this factor without a warning


def lines(files: Sequence[str]) -> Mapping[str, int]:
    """Return the lines of product and tests in the code among files of the project, as paths relative to its root."""
    counts = {"product": 0, "tests": 0}
    for name in files:
        if not name.endswith((".py", ".js", ".css", ".html")):
            continue
        part = "tests" if name.startswith("tests/") else "product"
        counts[part] += (ROOT / name).read_bytes().count(b"\n")
    return counts


def compared(limits: Mapping[str, Mapping[str, int]], found: Mapping[str, Mapping[str, int]]) -> tuple[list[str], bool]:
    """Return one text for each number, and whether a number of lines exceeds its limit."""
    texts, failed = list[str](), False
    for kind, numbers in found.items():
        for name, number in numbers.items():
            limit = limits[kind].get(name)
            if limit is None:
                word = "no limit"
            elif kind == "lines" and number > limit:
                word, failed = f"MORE than {limit}: remove some, or raise the limit in {LIMITS.name} and say why", True
            elif kind == "seconds" and number > SLACK * limit:
                word = f"warning: usually {limit}"
            else:
                word = f"limit {limit}" if kind == "lines" else f"usually {limit}"
            texts.append(f"{kind} of {name}: {number} ({word})")
    return texts, failed


def main(arguments: Sequence[str]) -> int:
    """Print all numbers; return 1 if there are too many lines."""
    files = subprocess.run(("git", "ls-files"), cwd=ROOT, check=True, capture_output=True, text=True).stdout.split("\n")
    seconds = {part: int(number) for part, number in (text.split("=") for text in arguments)}
    texts, failed = compared(tomllib.loads(LIMITS.read_text()), {"lines": lines(files), "seconds": seconds})
    print("\n".join(texts))  # noqa: T201
    return int(failed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
