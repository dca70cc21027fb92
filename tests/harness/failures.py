"""A pytest plug-in that writes each failure to a file as it happens: `-p tests.harness.failures --failures=FILE`.

The file is not a separate argument, because pytest would search its configuration next to it, too.

pytest's own list of failures (`--last-failed`) is empty after the death of a worker, so it cannot be used for this.
"""

import os
import re
from pathlib import Path
from typing import NamedTuple

import psutil
import pytest
from xdist.workermanage import WorkerController


class Failure(NamedTuple):
    """One failed phase of a test, or the death of a worker."""

    test: str  #: path and name, as pytest accepts them; empty for a worker
    phase: str  #: setup, call, teardown, collect or worker
    computer: str  #: load and stolen time at this moment
    message: str  #: last line of the error


def read_failures(path: Path) -> list[Failure]:
    """Return the failures in a file in their order."""
    return [Failure(*line.split("\t")) for line in path.read_text(encoding="utf-8").splitlines()]


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--failures", type=Path, help="file to which each failure is added")


class _Writer:
    """Hooks that add failures to the file; in the process that has the reports of all workers."""

    def __init__(self, path: Path, root: Path) -> None:
        self.path, self.root, self.start = path, root, psutil.cpu_times()

    def add(self, test: str, phase: str, message: str) -> None:
        now = psutil.cpu_times()
        stolen = (now.steal - self.start.steal) / max(sum(now) - sum(self.start), 1.0)
        computer = f"load {os.getloadavg()[0]:.1f}, {stolen:.0%} stolen since the start"
        last = re.sub(r"\s+", " ", message)[:300]
        with self.path.open("a", encoding="utf-8") as file:
            file.write("\t".join(Failure(test, phase, computer, last)) + "\n")

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            crash = getattr(report.longrepr, "reprcrash", None)
            text = crash.message if crash else str(report.longrepr).strip().rpartition("\n")[2]
            self.add(str(self.root / report.nodeid), "worker" if report.when == "???" else report.when, text)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed:
            self.add(str(self.root / report.nodeid), "collect", str(report.longrepr).strip().rpartition("\n")[2])

    def pytest_testnodedown(self, node: WorkerController, error: object) -> None:
        if error:
            self.add("", "worker", f"worker {node.gateway.id}: {error}")


def pytest_configure(config: pytest.Config) -> None:
    path: Path | None = config.getoption("--failures")
    if path is not None and not hasattr(config, "workerinput"):
        config.pluginmanager.register(_Writer(path, config.rootpath), "failures")
