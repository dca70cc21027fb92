"""Run tests, and look a second time at those that failed: `bash .ci/live PYTEST-ARGUMENTS`.

A test that needs real time may fail because the computer is busy. So each test that failed runs three times alone, each
time in a new process, and then its whole file runs once. If all of this passes, the test is UNSTEADY and the run is
green; the test is then to be mended (`tests/unsteady.toml`). If anything fails, the test is REFUSED and the run is red.

There is no second look where a failure may be dangerous or may not be repeatable: after the death of a worker, for
something that is left behind (all failures of the phase teardown), for faults, STOP, limits and leases, and if more
than `LARGEST` tests fail. A fault that shows with probability r in a single run is overlooked with probability
(1 - r)^4: 6 % at r = 0.5, 41 % at 0.2.
"""

import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from tests.harness.failures import Failure, read_failures
from tests.harness.root import ROOT

ALONE = 3  #: runs of a failed test alone
LARGEST = 4  #: unsteady tests in one run, of all its parts together
#: Tests that guard the robot: none of them is looked at a second time.
GUARDS = re.compile(
    r"live/faults/|(?<![a-z])(stop(s|ped|ping)?|halts?|emergency|limits?|bounds?|leases?|watchdog|overload)(?![a-z])"
)


def run(arguments: Sequence[str], failures: Path) -> int:
    """Run pytest in a new process; return its exit status."""
    recording = ("-p", "tests.harness.failures", f"--failures={failures}", "-p", "no:cacheprovider")
    return subprocess.run((sys.executable, "-m", "pytest", *recording, *arguments), cwd=ROOT, check=False).returncode


def never(failures: Sequence[Failure], allowed: int) -> str:
    """Return why there is no second look at a test with these failures; empty if there is one."""
    if any(one.phase not in ("setup", "call") for one in failures):
        return f"no second look after a failure of the phase {failures[-1].phase}"
    if GUARDS.search(failures[0].test.removeprefix(f"{ROOT}/")):
        return "no second look at a test of faults, STOP, limits or leases"
    return "" if allowed > 0 else f"more than {LARGEST} tests failed"


def again(test: str) -> str:
    """Run a test alone, then its whole file; return the first run that failed, or an empty text."""
    alone = ((f"alone, run {number} of {ALONE}", test) for number in range(1, ALONE + 1))
    for words, what in (*alone, ("with its whole file", test.partition("::")[0])):
        with tempfile.TemporaryDirectory() as folder:
            if run(("-n", "0", "-x", what), Path(folder, "failures")) != 0:
                return f"failed again {words}"
    return ""


def main(arguments: Sequence[str]) -> int:
    """Run the tests and the second look; add a line for each test that failed to the file named by CI_VERDICTS."""
    verdicts = Path(os.environ.get("CI_VERDICTS", os.devnull))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "failures")
        path.touch()
        status = run(arguments, path)
        failures = read_failures(path)
    tests = {one.test: [each for each in failures if each.test == one.test] for one in failures}
    earlier = verdicts.read_text(encoding="utf-8").count("UNSTEADY") if verdicts.is_file() else 0
    dead = any(one.phase == "worker" for one in failures)
    lines = [] if failures or status == 0 else [f"REFUSED pytest ended with status {status} and named no test"]
    for test, its in tests.items():
        name = test.removeprefix(f"{ROOT}/") or "a worker"
        reason = (
            "no second look after the death of a worker" if dead else never(its, LARGEST - earlier - len(tests) + 1)
        )
        reason = reason or again(test)
        word = f"REFUSED ({reason})" if reason else "UNSTEADY"
        lines.append(f"{word} {name} [{its[0].phase}; {its[0].computer}]: {its[0].message}")
    with verdicts.open("a", encoding="utf-8") as file:
        for line in lines:
            print(line)  # noqa: T201
            file.write(f"{line}\n")
    return int(any(line.startswith("REFUSED") for line in lines))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
