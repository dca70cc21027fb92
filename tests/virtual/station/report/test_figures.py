"""Figures of the experiments, drawn from shortened real runs; the numbers are recomputed here."""

import math
import re
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
import pytest

from station.experiments.results import fit_step
from station.recording.read import CaseRecording, read_case
from station.report import load_figures, loop_figures, style, tip_figures
from station.report.facts import head, origin
from station.report.page import FIGURES_BY_EXPERIMENT, figures
from station.report.run import RecordedRun, read_run

#: By experiment: duration [s], settling time [s], cases that are left out here, and names of the expected figures.
RUNS = {
    "fig3": (1.0, 0.0, ("b", "d"), ["fig3", "fig3_errors"]),
    "fig4": (1.5, 0.0, (), ["fig4", "rates"]),
    "fig6": (2.0, 0.5, (), ["fig6"]),
    "fig7": (1.5, 0.5, (), ["fig7"]),
    "fig8": (
        1.5, 0.5, ("lift_and_drop", "type_1_exact", "type_2", "regulation"),
        ["fig8", "fig8_regulation_distorted", "rates"],
    ),
    "fig10": (1.5, 0.5, ("feedforward",), ["fig10", "fig10_paper_distorted", "fig9", "rates"]),
    "step_response": (6.0, 0.0, ("k1_x", "k1_y", "k1_z", "k2_5_y", "k2_5_z", "k5_x", "k5_y", "k5_z"), ["steps"]),
}  # fmt: skip


@pytest.fixture(autouse=True)
def settings():
    with matplotlib.rc_context(style.MATPLOTLIB_SETTINGS):
        yield


@pytest.fixture(params=RUNS)
def run(request, preset_run) -> RecordedRun:
    return read_run(preset_run(request.param, *RUNS[request.param][:3]))


def recording(run: RecordedRun, case: str) -> CaseRecording:
    return read_case(run.folder / f"{case}.mcap")


def test_every_report_figure_has_units_texts_and_lines(run, tmp_path):
    drawn = list(figures(run))

    assert [one.name for one in drawn] == RUNS[run.experiment][3]
    for one in drawn:
        axes = one.figure.axes
        assert axes
        labelled = [each.get_ylabel() for each in axes if each.get_ylabel()]
        assert labelled
        assert all(re.search(r"\[(mm|N|mm/s)\]|part of the step", label) for label in labelled)
        assert "[s]" in axes[-1].get_xlabel()
        assert all(each.lines for each in axes)
        for line in (line for each in axes for line in each.lines):
            assert np.isfinite(np.asarray(line.get_ydata(), dtype=float)).all()
        assert len(one.alt) > 40
        assert len(one.caption) > 40
        assert "nan" not in one.alt + one.caption
        # Every figure with more than one line has a legend.
        assert one.figure.legends


def test_the_report_of_fig3_shows_the_true_tip_of_every_strategy(preset_run):
    run = read_run(preset_run("fig3", *RUNS["fig3"][:3]))
    positions, errors = tip_figures.strategies(run)
    z = {line.get_label(): line for line in positions.figure.axes[2].lines}

    assert set(z) == {
        "(a) unloaded Jacobian",
        "(c) inner loop: J(q, 0) and deflection rate, eq. (24)",
        "(d) with feed-forward",
        "desired",
    }
    tip = recording(run, "a").of("tip_true")
    shown = z["(a) unloaded Jacobian"].get_ydata()
    start = recording(run, "a").of("tip_desired")[0]
    assert np.max(shown) == pytest.approx(1e3 * (tip - start)[:, 2].max())
    # The desired z after 1 s is 15 mm sin(2 pi 0.05 t).
    assert np.max(z["desired"].get_ydata()) == pytest.approx(15.0 * math.sin(0.1 * math.pi), abs=0.02)
    largest = 1e3 * np.abs(recording(run, "c").of("tip_desired") - recording(run, "c").of("tip_true")).max(axis=0)
    assert f"c: {largest[0]:.2f}, {largest[1]:.2f}, {largest[2]:.2f} mm" in errors.alt


def test_the_caption_of_fig4_has_the_size_of_each_part_of_the_deflection(preset_run):
    run = read_run(preset_run("fig4", *RUNS["fig4"][:3]))
    (drawn,) = load_figures.deflection(run)
    rows = recording(run, "deflection")
    one, two = (1e3 * np.linalg.norm(rows.of(group), axis=1).max() for group in ("delta_1", "delta_2"))

    assert f"part of the load {one:.2f} mm, part of the Jacobian {two:.2f} mm" in drawn.caption
    assert f"{one / two:.1f} times" in drawn.caption
    assert [len(axes.lines) for axes in drawn.figure.axes] == [3, 3, 3]


def test_the_report_of_fig6_shows_the_mean_model_distances_of_the_summary(preset_run):
    run = read_run(preset_run("fig6", *RUNS["fig6"][:3]))
    (drawn,) = tip_figures.models(run)
    numbers = run.summary["cases"]["turn"]["model_error_mm"]
    rows = recording(run, "turn")
    late = rows.of("tip_new")[:, 0] > 0.0  # all frames count, because the load acts from the start on
    # The unloaded model does not use the noisy force, so averaging over 0.5 s hardly changes its tip.
    at = rows.of("tip_time")[late, 0]
    unloaded = np.stack([np.interp(at, rows.of("time")[:, 0], tip) for tip in rows.of("tip_unloaded").T], axis=1)
    distance = 1e3 * np.linalg.norm(unloaded - rows.of("tip_measured")[late], axis=1).mean()

    assert numbers["unloaded"] == pytest.approx(distance, abs=0.03)
    assert f"loaded model {numbers['loaded']:.2f} mm, unloaded model {numbers['unloaded']:.2f} mm" in drawn.caption
    assert numbers["loaded"] < numbers["unloaded"]


def test_the_report_of_fig7_shows_the_papers_bounds(preset_run):
    (drawn,) = tip_figures.tracking(read_run(preset_run("fig7", *RUNS["fig7"][:3])))
    for axes, bound in zip(drawn.figure.axes[:3], (15.5, 2.3, 1.1), strict=True):
        level = [
            line.get_ydata()[0] for line in axes.lines if line.get_linestyle() == ":" or len(line.get_ydata()) == 2
        ]
        assert sorted(level)[0] == -bound
        assert sorted(level)[-1] == bound


def test_the_fig9_figure_of_a_complete_run_starts_at_100_s(synthetic_case):
    case = synthetic_case(time=np.linspace(0.0, 250.0, 40), force_filtered=np.full((40, 3), 0.2))
    (drawn,) = load_figures.paper_force(RecordedRun(Path("x"), "fig10", {}, {}, (case,)))
    left, right = drawn.figure.axes[0].dataLim.intervalx

    assert left >= 100.0
    assert right <= 200.0
    assert "100 to 200 s" in drawn.caption or "103 to 199 s" in drawn.caption


def test_the_step_response_figure_has_the_fit(preset_run):
    run = read_run(preset_run("step_response", *RUNS["step_response"][:3]))
    (drawn,) = loop_figures.steps(run)
    step = run.summary["cases"]["k2_5_x"]["step"]
    answer = drawn.figure.axes[0].lines[0]

    assert f"k 2.5 x: {step['rate']:.2f} 1/s after {1e3 * step['dead_time_s']:.0f} ms" in drawn.alt
    again = fit_step(np.asarray(answer.get_xdata()), np.asarray(answer.get_ydata()))
    assert again.rate == pytest.approx(step["rate"], rel=0.05)


def test_a_report_of_any_other_experiment_shows_path_error_force_and_joints(short_run):
    run = read_run(short_run)
    assert "short" not in FIGURES_BY_EXPERIMENT
    drawn = {one.name: one for one in figures(run)}

    assert list(drawn) == [f"{what}_{case}" for case in ("one", "two") for what in ("path", "error", "force", "joints")]
    z = drawn["path_one"].figure.axes[2]
    rows = read_case(short_run / "one.mcap")
    assert z.dataLim.intervaly[1] >= 1e3 * rows.of("tip_true")[:, 2].max() - 1e-9
    joints = drawn["joints_one"].figure.axes
    assert [axes.get_ylabel() for axes in joints] == [
        "outer\nrotation [deg]", "inner\nrotation [deg]", "inner\ntranslation [mm]",
    ]  # fmt: skip
    shown = np.asarray(joints[1].lines[0].get_ydata())
    assert shown[0] == pytest.approx(np.degrees(rows.of("joints")[0, 1]))


def test_a_report_without_ground_truth_shows_no_true_values_and_names_simulated_devices(synthetic_case):
    case = synthetic_case(truth_known=np.zeros(40), tip_measured=np.full((40, 3), 0.001))
    run = RecordedRun(Path("x"), "own", {}, {}, (case,))
    texts = " ".join(f"{one.caption} {one.alt}" for one in tip_figures.overview(run))

    assert not run.simulated
    assert "true" not in texts
    assert "simulated" not in texts
    run = RecordedRun(Path("x"), "own", {}, {}, (replace(case, metadata={"simulated": True}),))
    assert run.simulated
    assert origin(run) == "simulated bench"
    assert "Simulated bench" in " ".join(head(run))


def test_a_report_shows_the_recorded_timing_of_the_control_loop():
    late, work = [0] * 40, [0] * 300
    late[20], late[39], work[120], work[299] = 900, 100, 990, 10
    numbers = {
        "ticks": 1000, "missed": 2, "scheduler": "SCHED_FIFO", "late_counts": late, "tick_counts": work,
        "late_us": {"p50": 20, "p99": 39, "max": 41}, "tick_us": {"p50": 120, "p99": 299, "max": 420},
    }  # fmt: skip
    (drawn,) = loop_figures.timing(RecordedRun(Path("x"), "own", {"cases": {"run": {"timing": numbers}}}, {}, ()))

    assert "late: median 20, 99 % 39, largest 41" in drawn.caption
    assert "2 periods missed" in drawn.caption
    for axes, counts in zip(drawn.figure.axes, (late, work), strict=True):
        bars = axes.patches[0].get_data()
        assert axes.get_xscale() == "log"
        assert (bars.edges[0], bars.edges[-1]) == (0.5, len(counts))
        assert bars.values.sum() == 1000
        for place, count in enumerate(counts):
            if count:
                assert bars.values[np.searchsorted(bars.edges, place, side="right") - 1] == count


def test_a_report_without_the_rows_of_a_figure_does_not_have_the_figure(synthetic_case):
    ended, short = (synthetic_case(settling=settling) for settling in (10.0, 2.0))
    assert list(tip_figures.models(RecordedRun(Path("x"), "fig6", {}, {}, (ended,)))) == []
    assert list(load_figures.deflection_rate(RecordedRun(Path("x"), "fig10", {}, {}, (short,)))) == []
    assert list(loop_figures.timing(RecordedRun(Path("x"), "own", {"cases": {"one": {}}}, {}, ()))) == []
    for name in RUNS:
        assert list(figures(RecordedRun(Path("x"), name, {}, {}, ()))) == []
