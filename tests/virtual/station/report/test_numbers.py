"""Each number that report and terminal print about a run is recomputed here from the exported CSV.

Settings, and the rates of the serial line, which the CSV does not have, are no results.
"""

import csv
import math
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from station.cli.main import main
from station.report.page import write_report
from tests.harness.report_page import Page

NUMBER = r"(?<![\w.-])-?\d+(?:\.\d+)?(?!\w|\.\d)"
#: Standard deviation above which a force is unknown [N].
UNKNOWN_N = 0.05
#: Desired force of `touch`, forces of the palpation, and the paper's errors of its Fig. 8 [mm].
PRESSED_N, LIGHT_N, PAPER = 0.2, 0.05, [2.2, 2.8, 0.8]
#: Run: arguments of `preset_run`, and time from which the errors of each case count [s].
RUNS = {
    "fig8": ((1.5, 0.5, ("lift_and_drop", "type_1_exact", "type_2", "regulation")), 0.0),
    "touch": ((3.0, 1.0, ("soft", "axial", "moving", "fast", "circle")), 1.0),
    "fewer_devices": ((3.0, 0.5, ("tracker_only_lift_and_drop", "tracker_only_quick", "tracker_only_sinusoid",
                                  "stages_only")), 0.0),
    "two_places": ((), 2.0),
}  # fmt: skip


def rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(np.square(values), axis=0))


class Case:
    """Columns of a case's CSV, and what is computed from them."""

    def __init__(self, path: Path, first: float) -> None:
        with path.open(encoding="utf-8") as file:
            self.names = [name.split(" [")[0] for name in next(csv.reader([file.readline()]))]
            self.rows = np.loadtxt(file, delimiter=",")
        self.name, self.first, self.time = path.stem, first, self.rows[:, 0]
        self.late = self.time >= first - 1e-9
        new = self("tip_new")[:, 0] > 0.0
        self.error = {"true": 1e3 * (self("tip_desired") - self("tip_true"))[self.late]}
        if new.any():
            at, taken = new & self.late, self("tip_time")[:, 0]
            desired = np.stack([np.interp(taken[at], self.time, one) for one in self("tip_desired").T], axis=1)
            self.error = {"measured": 1e3 * (desired - self("tip_measured")[at]), **self.error}
        self.travel = np.ptp(1e3 * self("tip_measured")[new], axis=0) if new.any() else np.zeros(3)
        self.senses = self("trouble")[0, 2] != -1.0  # -1: the bench does not have the device
        self.unknown = np.sqrt(np.median(self("force_variance"), axis=0)) > UNKNOWN_N
        self.force = np.linalg.norm(self("force_filtered")[:, ~self.unknown], axis=1).max()
        lengths = np.linalg.norm(self.error["true"], axis=1)
        self.distance = (lengths.max(), math.sqrt(np.mean(lengths**2)))

    def __call__(self, group: str) -> np.ndarray:
        return self.rows[:, [name == group or name.startswith(f"{group}.") for name in self.names]]

    def presses(self) -> list[np.ndarray]:
        """Return estimated and true force along the direction x of the press (ticks,) [N]."""
        return [-self(group)[:, 0] for group in ("force_filtered", "force_true")]

    def contact(self, least: float = PRESSED_N) -> float:
        """Return the time of the first contact [s]: a quarter of the force, and three standard deviations."""
        spread = np.sqrt(self("force_variance")[:, 0])
        return float(self.time[(self.presses()[0] >= np.maximum(0.25 * least, 3.0 * spread)).argmax()])

    def held(self) -> tuple[list[float], list[float]]:
        """Return from when the force's errors count [s], and mean and RMS error [N], estimated and true."""
        since = max(self.first, float(self.time[(self.presses()[0] >= 0.9 * PRESSED_N).argmax()]))
        errors = [force[self.time >= since - 1e-9] - PRESSED_N for force in self.presses()]
        return [since], [value for one in errors for value in (one.mean(), float(rms(one)))]

    def dwells(self, times: np.ndarray) -> Iterator[np.ndarray]:
        """Yield which of `times` count for each force: 2 s of travel, 2 s with the light and 2 s with the firm force.

        The second half of the time for a force counts. There are two places.
        """
        for start in (3.0, 5.0, 9.0, 11.0):
            yield (times >= start) & (times < start + 1.0)

    def palpated_errors(self) -> list[float]:
        """Return mean and RMS error of the forces of a palpation [N], estimated and true."""
        found = []
        for force in self.presses():
            parts = zip(self.dwells(self.time), 2 * (LIGHT_N, PRESSED_N), strict=True)
            error = np.concatenate([force[at] - desired for at, desired in parts])
            found += [error.mean(), float(rms(error))]
        return found

    def palpated(self) -> tuple[list[float], list[float]]:
        """Return the stiffness of both places [N/m], and RMS and largest error relative to the wall's 200 N/m [%]."""
        new = self("tip_new")[:, 0] > 0.0
        taken, tip = self("tip_time")[new, 0], self("tip_measured")[new, 0]
        forces = [self.presses()[0][at].mean() for at in self.dwells(self.time)]
        tips = [tip[at].mean() for at in self.dwells(taken)]
        found = np.array([(forces[k + 1] - forces[k]) / (tips[k + 1] - tips[k]) for k in (0, 2)])
        error = 100.0 * (found / 200.0 - 1.0)
        return list(found), [float(rms(error)), float(np.abs(error).max())]

    def by_deflection(self) -> list[float]:
        """Return hits and unknown directions [%], and RMS error [N] of the force from the deflection."""
        at = self.late & (self("tip_new")[:, 0] > 0.0)
        xx, xy, xz, yy, yz, zz = self("force_by_deflection_covariance")[at].T
        errors = (self("force_by_deflection") - self("force_true"))[at]
        found = []
        for matrix, error in zip(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]).T, errors, strict=True):
            values, directions = np.linalg.eigh(matrix)
            found += [(math.sqrt(value), abs(way @ error)) for value, way in zip(values, directions.T, strict=True)]
        known = np.array([one for one in found if one[0] <= UNKNOWN_N])
        hits = np.mean(known[:, 1] <= 1.96 * known[:, 0])
        return [100.0 * hits, 100.0 * (1.0 - len(known) / len(found)), float(rms(known[:, 1]))]

    def rates(self) -> list[float]:
        """Return the RMS of raw, filtered and exact rate of the deflection minus that of a cubic through one second."""
        deflection, count = 1e3 * self("deflection"), 501
        hindsight = np.empty_like(deflection)
        for tick in range(len(deflection)):
            start = min(max(tick - count // 2, 0), len(deflection) - count)
            at = 0.002 * (np.arange(start, start + count) - tick)
            hindsight[tick] = np.polynomial.polynomial.polyfit(at, deflection[start : start + count], 3)[1]
        groups = ("deflection_rate_raw", "deflection_rate", "deflection_rate_exact")
        return [value for group in groups for value in rms((1e3 * self(group) - hindsight)[self.late])]


def agree(text: str, expected: list[float]) -> None:
    """Check that a text has exactly these numbers, up to one unit of the last digit: a recording is rounded."""
    found = re.findall(NUMBER, text)
    assert len(found) == len(expected), (text, expected)
    for one, value in zip(found, expected, strict=True):
        digits = len(one.partition(".")[2])
        assert float(one) == pytest.approx(value, abs=1.05 * 10.0**-digits), (text, expected)


def both(values: list[float], digits: int = 2) -> list[float]:
    """Return what a headline prints of several values: the smallest and the largest, or one if they print alike."""
    low, high = min(values), max(values)
    return [high] if f"{low:.{digits}f}" == f"{high:.{digits}f}" else [low, high]


def headline(run: str, cases: list[Case]) -> list[float]:
    if run == "touch":
        (case,) = cases
        force = case.presses()[0]
        held = 0.002 * (np.abs(force - PRESSED_N) <= 0.1 * PRESSED_N).sum()
        return [force.max(), PRESSED_N, force.max() - PRESSED_N, case.contact(), 10.0, held]
    if run == "two_places":
        stiffness, errors = cases[0].palpated()
        return [*both(stiffness, 0), 2.0, errors[0]]
    found = [number for each in zip(*(case.distance for case in cases), strict=True) for number in both(list(each))]
    unknown = sum(case.unknown.any() for case in cases)
    left_out = [unknown, len(cases)] if 0 < unknown < len(cases) else []
    return [*found, max(case.force for case in cases), *left_out]


def table(run: str, case: Case) -> Iterator[tuple[str, list[float]]]:
    """Yield the start of each quantity in a case's rows of the table of results, and the numbers of its row."""
    for kind, error in case.error.items():
        paper = PAPER if kind == "measured" and case.name == "type_1" else []
        yield f"max |E| {kind}", [case.first, *np.abs(error).max(axis=0), *paper]
        yield f"RMS E {kind}", [case.first, *rms(error)]
    if not case.senses:
        hits, unknown, error = case.by_deflection()
        yield "RMS error of the force from the deflection", [hits, 95.0, unknown, error]
    if run in ("touch", "two_places"):
        since, errors = case.held() if run == "touch" else ([], case.palpated_errors())
        yield "error of the force held, estimated", [*since, *errors[:2]]
        yield "error of the force held, true", [*since, *errors[2:]]
    if run == "two_places":
        yield "error of the stiffness", case.palpated()[1]


def captions(run: str, case: Case) -> Iterator[tuple[str, list[float]]]:
    """Yield the start of the text of each of a case's figures, and its numbers."""
    suffix = f" (case {case.name.replace('_', ' ')})."
    largest = [value for error in case.error.values() for value in np.abs(error).max(axis=0)]
    errors = [*([case.first] if case.first > 0.0 else []), *largest]
    if run == "fig8":
        title = "Fig. 8: regulation with the dual-layer controller" if case.name == "type_1" else "Tracking error"
        yield title + suffix, errors
        if case.name == "type_1":
            yield "Rate of the deflection" + suffix, [20.0, *case.rates()]
        return
    if run != "fewer_devices":
        since, held = case.held() if run == "touch" else ([], case.palpated_errors())
        contact = case.contact(PRESSED_N if run == "touch" else LIGHT_N)
        yield "Force on the obstacle" + suffix, [contact, *since, *(1e3 * one for one in held), 25.0, 3.0]
    if run == "two_places":
        yield "Stiffness map" + suffix, [PRESSED_N, LIGHT_N, 2.0, 2.0, *case.palpated()[1]]
    yield "Position of the tip" + suffix, list(case.travel)
    yield "Tracking error" + suffix, errors
    forces = [
        rms((case(group) - case("force_true"))[case.late])[~case.unknown] for group in ("force", "force_filtered")
    ]
    times = [case.time[0], case.time[-1], case.time[case.late][0], case.time[-1]]
    yield "Estimated force at the tip" + suffix, [*times, *forces[0], *forces[1]]


@pytest.fixture(scope="module", params=RUNS)
def made(request, preset_run, run_of, palpation, tmp_path_factory) -> tuple[str, list[Case], Page, list[str]]:
    """Return name of a run, its cases, its report, and the lines that the terminal has printed."""
    arguments, first = RUNS[request.param]
    folder = preset_run(request.param, *arguments) if arguments else run_of(request.param, palpation)
    out = tmp_path_factory.mktemp("exported")
    assert main(("export", str(folder), "--format", "csv", "--out", str(out))) == 0
    cases = [Case(path, first) for path in sorted(out.glob("*.csv"))]
    page = Page(write_report(folder, out).read_text(encoding="utf-8"))
    return request.param, cases, page, (folder.parent / "printed.txt").read_text(encoding="utf-8").splitlines()


def test_first_line_of_terminal_and_report_is_recomputed_from_the_csv(made) -> None:
    run, cases, page, printed = made

    agree(printed[0], headline(run, cases))
    assert printed[0] == page.paragraphs[1].strip()
    for case in cases if len(cases) > 1 else ():
        start = f"{case.name.replace('_', ' ')}: "
        (line,) = [one.removeprefix(start) for one in page.paragraphs if one.startswith(start)]
        agree(line, headline(run, [case]))


def check_rows(rows: list[list[str]], run: str, cases: list[Case]) -> None:
    """Check the rows of a table of results; a first cell may be left out, and a row may continue in the next one."""
    texts, name, key = dict[tuple[str, str], str](), "", ""
    for first, quantity, *cells in rows:
        name, key = first or name, quantity or key
        texts[name, key] = " ".join((texts.get((name, key), quantity), *cells))
    expected = {(case.name, start): values for case in cases for start, values in table(run, case)}
    assert len(texts) == len(expected)
    for (case, quantity), text in texts.items():
        (start,) = [one for name, one in expected if name == case and quantity.startswith(one)]
        agree(text, expected[case, start])


def test_each_number_of_the_terminal_is_recomputed_from_the_csv(made) -> None:
    run, cases, _, printed = made
    lines = [line.strip("│").split("│") for line in printed if line.startswith("│")]
    check_rows([[cell.strip() for cell in line] for line in lines], run, cases)


def test_each_number_of_the_report_is_recomputed_from_the_csv(made) -> None:
    run, cases, page, _ = made
    check_rows([row for row in page.rows if len(row) == 6 and row[0] != "case"], run, cases)

    texts = {start: values for case in cases for start, values in captions(run, case)}
    for text in page.captions:
        if not text.startswith("Joints"):  # has no number
            (start,) = [one for one in texts if text.startswith(one)]
            agree(text.removeprefix(start), texts.pop(start))
    assert not texts
