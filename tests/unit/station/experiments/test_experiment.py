"""The presets are the agreed experiments; a file that cannot be run is refused before anything runs."""

import math
import re

import numpy as np
import pytest

from core.control.controllers import PositionMode, VelocityMode, loaded, type_1, type_2, unloaded
from core.control.trajectories import JointMotion, Setpoint
from station.config.strict import OWN_EXPERIMENTS, ConfigError, preset_names
from station.experiments.experiment import Case, load_experiment, offered
from station.lab.config import LabConfig
from tests.harness.cases import a_case

#: name: duration [s], settling [s], cases
AGREED = {
    "fig3": (40.0, 0.0, ["a", "b", "c", "d", "d_feedforward"]),
    "fig4": (40.0, 0.0, ["deflection"]),
    "fig6": (120.0, 2.0, ["turn"]),
    "fig7": (60.0, 2.0, ["regulation"]),
    "fig8": (60.0, 2.0, ["regulation", "lift_and_drop", "type_1", "type_1_exact", "type_2", "regulation_distorted"]),
    "fig10": (200.0, 20.0, ["paper", "feedforward", "paper_distorted"]),
}


def desired(case: Case, time: float) -> np.ndarray:
    order = case.orders.at(time)
    assert isinstance(order, Setpoint)
    return order.position


def test_every_agreed_experiment_is_a_preset():
    assert set(AGREED) <= set(preset_names("experiments"))


@pytest.mark.parametrize("name", preset_names("experiments"))
def test_every_preset_can_be_run_from_the_agreed_pose(name):
    experiment = offered(name)

    assert experiment.name == name
    assert experiment.title
    for case in experiment.cases:
        assert case.start == pytest.approx([0.0, math.pi / 2.0, -0.100])
        assert case.robot.name == "paper"


@pytest.mark.parametrize("name", AGREED)
def test_a_preset_has_its_cases_and_lasts_as_long_as_agreed(name):
    duration, settling, cases = AGREED[name]
    experiment = offered(name)

    assert [case.name for case in experiment.cases] == cases
    assert (experiment.cases[0].file.duration, experiment.cases[0].file.settling) == (duration, settling)


@pytest.mark.parametrize(
    ("name", "amplitude"), [("fig3", 0.015), ("fig4", 0.015), ("fig10", 0.010)]
)  # all along z at 0.05 Hz
def test_the_tracking_experiments_follow_a_sinusoid_along_z(name, amplitude):
    for case in offered(name).cases:
        for time, z in {0.0: 0.0, 5.0: amplitude, 10.0: 0.0, 15.0: -amplitude, 25.0: amplitude}.items():
            assert desired(case, time) == pytest.approx([0.0, 0.0, z], abs=1e-12)


@pytest.mark.parametrize("name", ["fig7", "fig8"])
def test_the_regulation_experiments_stay(name):
    for case in offered(name).cases:
        assert not desired(case, 0.0).any()
        assert not desired(case, 17.0).any()


def test_fig6_turns_the_outer_tube_once_at_3_degrees_a_second():
    case = a_case("fig6", "turn")
    for time, speed in {0.0: 3.0, 119.9: 3.0, 120.1: 0.0}.items():
        order = case.orders.at(time)
        assert isinstance(order, JointMotion)
        assert np.degrees(order.velocity) == pytest.approx([speed, 0.0, 0.0])


@pytest.mark.parametrize(
    ("experiment", "case", "by_time"),
    [
        ("fig3", "a", {0.0: 0.0, 5.0: 0.2, 15.0: -0.2, 20.0: 0.0}),
        ("fig4", "deflection", {0.0: 0.0, 5.0: 0.2, 15.0: -0.2}),
        ("fig6", "turn", {0.0: 0.5, 119.0: 0.5}),
        ("fig7", "regulation", {0.0: 0.0, 5.0: 0.25, 10.0: 0.5, 20.0: 0.0, 30.0: 0.5}),
        ("fig8", "regulation", {0.0: 0.0, 5.0: 0.25, 10.0: 0.5, 20.0: 0.0}),
        ("fig10", "paper", {0.0: 0.0, 5.0: 0.25, 10.0: 0.5, 20.0: 0.0, 190.0: 0.5}),
    ],
)
def test_the_load_pulls_along_gravity_as_agreed(experiment, case, by_time):
    load = a_case(experiment, case).file.load
    for time, force in by_time.items():
        assert load.force(time) == pytest.approx([force, 0.0, 0.0], abs=1e-12)


def test_lift_and_drop_takes_half_a_newton_up_and_down_within_2_5_seconds_each():
    case = a_case("fig8", "lift_and_drop")
    force = np.array([case.file.load.force(time)[0] for time in np.arange(0.0, case.file.duration, 0.1)])
    rising, falling = np.flatnonzero(np.diff(force) > 1e-9), np.flatnonzero(np.diff(force) < -1e-9)

    assert force.max() == pytest.approx(0.5)
    assert force[0] == force[-1] == 0.0
    assert len(rising) == len(falling) == 25
    assert rising[-1] < falling[0]


def test_the_simulations_of_the_paper_use_the_nominal_rod_and_ideal_devices_and_say_so():
    for name in ("fig3", "fig4"):
        for case in offered(name).cases:
            plant = case.lab.plant
            assert "ideal" in case.lab.title
            assert (dict(plant.tubes), dict(plant.play), plant.vary) == ({}, {}, 0.0)
            assert {tube.poisson_ratio for tube in case.robot.tubes} == {plant.poisson_ratio}
            assert (plant.friction_force, plant.friction_moment) == (0.0, 0.0)
            assert case.lab.devices == "ideal"


def test_the_experiments_of_the_paper_use_the_default_lab_but_for_the_tracker_near_metal():
    default = LabConfig()
    bent = default.tracker.model_copy(update={"distortion": 0.48e-3})
    for name in ("fig6", "fig7", "fig8", "fig10"):
        for case in offered(name).cases:
            distorted = case.name.endswith("_distorted")
            assert case.lab.plant == default.plant
            assert case.lab.sensors == default.sensors
            assert case.lab.tracker == (bent if distorted else default.tracker)
            assert (case.lab.title == default.title) is not distorted


def test_the_default_lab_has_the_agreed_numbers():
    lab = LabConfig()

    assert lab.devices == "wire"
    assert (lab.tracker.rate, lab.tracker.latency, lab.tracker.noise) == (40.0, 0.024, 0.1e-3)
    assert (lab.sensors.force_noise, lab.sensors.moment_noise) == (0.02, 0.2e-3)
    assert lab.sensors.drift == pytest.approx(0.005 / 60.0)
    assert (lab.plant.friction_force, lab.plant.friction_moment) == (0.05, 0.5e-3)
    assert lab.plant.play == {"inner_rotation": pytest.approx(math.radians(0.1))}
    assert lab.plant.poisson_ratio == 0.35
    assert {name: (error.stiffness, error.curvature) for name, error in lab.plant.tubes.items()} == {
        "inner": (-0.05, -0.03),
        "outer": (0.04, 0.02),
    }


@pytest.mark.parametrize(
    ("experiment", "case", "outer", "inner"),
    [
        ("fig3", "a", VelocityMode(), unloaded),
        ("fig3", "b", VelocityMode(), loaded),
        ("fig3", "c", VelocityMode(), type_1),
        ("fig3", "d", PositionMode(2.5, 2.5), type_1),
        ("fig3", "d_feedforward", PositionMode(2.5, 2.5, feedforward=True), type_1),
        ("fig7", "regulation", VelocityMode(), unloaded),
        ("fig10", "paper", PositionMode(2.5, 2.5), type_1),
        ("fig10", "feedforward", PositionMode(2.5, 2.5, feedforward=True), type_2),
    ],
)
def test_a_case_has_the_strategy_it_is_named_for(experiment, case, outer, inner):
    strategy = a_case(experiment, case).controller.strategy

    assert strategy.outer == outer
    assert strategy.inner is inner


def test_the_papers_own_numbers_stand_beside():
    assert offered("fig3").paper["a"].max_abs_error_mm == {"x": 7.9}
    assert offered("fig7").paper["regulation"].max_abs_error_mm == {"x": 15.5, "y": 2.3, "z": 1.1}
    assert offered("fig10").paper["paper"].max_abs_error_mm == {"x": 1.0, "z": 1.7}
    assert offered("fig6").paper["turn"].model_error_mm["loaded"] == 1.4


def test_a_case_changes_what_it_names_and_keeps_the_rest(write, short):
    path = write(
        'lab = "ideal"\n' + short + "[cases.one]\n[cases.two]\nduration = 3.0\n"
        '[cases.two.trajectory]\nkind = "circle"\nradius = 0.01\nperiod = 8.0\n'
    )
    one, two = load_experiment(str(path)).cases

    assert (one.name, one.file.duration, one.file.trajectory.kind) == ("one", 1.0, "hold")
    assert (two.name, two.file.duration, two.file.trajectory.kind) == ("two", 3.0, "circle")
    assert one.lab == two.lab
    assert "ideal" in two.lab.title


CROSS = """
[cross.strategy.a.controller]
k1 = 1.0
[cross.strategy.b]
[cross.length.short]
[cross.length.long]
duration = 3.0
controller = { k2 = 4.0 }
"""


def test_every_choice_of_one_axis_is_a_case_with_every_choice_of_the_others(write, short):
    cases = load_experiment(str(write(short + "[cases.first]\n" + CROSS))).cases

    assert [(case.name, case.file.duration, case.file.controller.k1, case.file.controller.k2) for case in cases] == [
        ("first", 1.0, 2.5, 2.5),
        ("a-short", 1.0, 1.0, 2.5),
        ("a-long", 3.0, 1.0, 4.0),
        ("b-short", 1.0, 2.5, 2.5),
        ("b-long", 3.0, 2.5, 4.0),
    ]


def test_a_mistake_in_a_choice_is_told_with_the_case(write, short):
    for wrong, said in (
        ("[cross.length.odd]\nbogus = 1\n", "case 'a-odd': unknown key 'bogus'"),
        ("[cross.length]\n", "cross.length = {}: "),
        ("[cross]\nlength = 3\n", "cross.length = 3: "),
    ):
        text = short + "[cross.strategy.a]\n" + wrong if "[cross]" not in wrong else short + wrong
        with pytest.raises(ConfigError, match=re.escape(said)):
            load_experiment(str(write(text)))


def test_more_cases_than_anybody_waits_for_are_refused_before_they_are_tried(write, short):
    axes = "".join(f"[cross.axis{axis}.choice{number}]\n" for axis in range(6) for number in range(10))
    with pytest.raises(ConfigError, match=r"own\.toml: 1000000 cases; at most 1000"):
        load_experiment(str(write(short + axes)))


FASTER = ("ramp_1s", "ramp_0_5s", "ramp_0_25s", "ramp_0_1s", "step", "rubber_band", "lift_and_drop", "tap")


def test_load_rate_puts_on_and_takes_off_half_a_newton_at_every_rate_under_every_strategy():
    cases = {case.name: case for case in offered("load_rate").cases}
    strategies, loads = ("regulation", "type_1", "held"), ("ramp_10s", "ramp_1s", "ramp_0_1s", "step", "tap")

    assert len(cases) == 36
    assert {f"{strategy}-{load}" for strategy in strategies for load in loads} <= set(cases)
    for case in cases.values():
        load, duration = case.file.load, case.file.duration
        force = [load.force(time)[0] for time in np.arange(0.0, duration, 0.005)]
        assert max(force) == pytest.approx(0.5, rel=2e-3) or load.kind == "hung_weight"
        assert load.onset == 2.0
        assert load.changes[-1] + 8.0 < duration
    # What is slower than the joints is not warned of, nor is what nobody tries to make up for.
    warned = {name for name, case in cases.items() if case.warnings}
    assert warned == {f"{one}-{load}" for one in strategies[:2] for load in FASTER}


def test_a_file_without_cases_is_one_case_of_its_own_name(write, short):
    experiment = load_experiment(str(write(short, "my run")))

    assert experiment.name == "my run"
    assert [case.name for case in experiment.cases] == ["my run"]
    assert experiment.source == short


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("duration = 1.0", "duration = nan", "duration = nan: Input should be a finite number"),
        ("duration = 1.0", "duration = 0.0", "duration = 0.0: Input should be greater than 0"),
        ("duration = 1.0", "duration = 1e9", "duration = 1000000000.0: Input should be less than or equal to 86400"),
        ("duration = 1.0", 'duration = "1"', "duration = '1': Input should be a valid number"),
        ("duration = 1.0", "", "'duration' is missing"),
        ("settling = 0.0", "settling = -1.0", "settling = -1.0: "),
        ("settling = 0.0", "setling = 0.0", "unknown key 'setling'"),
        ("-0.100", "-0.150", "inner_translation -0.15 m is outside -0.13 ... -0.005 m"),
        ("-0.100", "0.010", "inner_translation 0.01 m is outside -0.13 ... -0.005 m"),
        ("-0.100", "nan", "start.inner_translation = nan: Input should be a finite number"),
        ("outer_rotation = 0.0", "outer_rotation = 7.0", "outer_rotation 7 rad is outside -6.283 ... 6.283 rad"),
        ("outer_rotation", "outer_spin", "start.outer_spin: robot 'paper' has no such joint; it has outer_rotation, "),
        ("outer_rotation = 0.0, ", "", "start.outer_rotation is missing"),
        ('kind = "hold"', 'kind = "jump"', "trajectory = {'kind': 'jump'}: "),
        ('kind = "hold"', 'kind = "sinusoid"\namplitude = 9.0\nfrequency = 1.0', "trajectory.amplitude = 9.0: "),
        (
            'kind = "hold"',
            'kind = "joint_sweep"\njoint = "elbow"\nspeed = 0.1\ndistance = 0.1',
            "joint_sweep: 'elbow' is not one of outer_rotation, inner_rotation, inner_translation",
        ),
        (
            'kind = "hold"',
            'kind = "joint_sweep"\njoint = "inner_translation"\nspeed = 0.01\ndistance = 0.1',
            "inner_translation 0 m is outside -0.13 ... -0.005 m",
        ),
        ('kind = "hold"', 'kind = "hold"\n[load]\nkind = "constant"\nmagnitude = -1', "load.magnitude = -1: "),
        ('kind = "hold"', 'kind = "hold"\n[controller]\nstrategy = "magic"', "strategy 'magic' is unknown"),
        ('kind = "hold"', 'kind = "hold"\n[controller]\nk1 = nan', "controller.k1 = nan: "),
        ('kind = "hold"', 'kind = "hold"\n[controller]\nk1 = 51.0', "K1 = 51 1/s is outside 0 ... 50 1/s"),
        ('kind = "hold"', 'kind = "hold"\n[controller]\nk3 = 1.0', "unknown key 'controller.k3'"),
        ('kind = "hold"', 'kind = "hold"\n[controller]\nfeedforward = "no"', "controller.feedforward = 'no': "),
        ('kind = "hold"', 'kind = "hold"\n[controller]\nsublink = 0.0', "controller.sublink = 0.0: "),
        ('kind = "hold"', 'kind = "hold"\n[controller]\nfilter_bandwidth = 0.0', "filter bandwidth 0 Hz is outside "),
        ('kind = "hold"', 'kind = "hold"\n[cases]\nfast = 3', "cases.fast = 3: "),
        ('kind = "hold"', 'kind = "hold"\n[cases."../fast"]', "'../fast': "),
        ('kind = "hold"', 'kind = "hold"\n[cases.fast]\nbogus = 1', "case 'fast': unknown key 'bogus'"),
        ('kind = "hold"', 'kind = "hold"\n[paper.slow]', "paper.slow is not one of the cases: own"),
        ('kind = "hold"', 'kind = "hold"\n[paper.own]\nmax = 1', "unknown key 'paper.own.max'"),
        ('title = "short"', 'title = "short"\nrobot = "snake"', "'snake' is not one of the robots: nylon, paper"),
        (
            'title = "short"',
            'title = "short"\nlab = "moon"',
            "'moon' is not one of the labs: breathing, distorted, gentle, heartbeat, ideal, realistic",
        ),
        ('title = "short"', 'title = "short"\nlab = "none.toml"', "none.toml: no such file"),
        ('title = "short"', 'title = "short', "not valid TOML: "),
    ],
)
def test_an_experiment_that_cannot_be_is_refused_in_one_line(write, short, old, new, said):
    assert short.count(old) == 1
    path = write(short.replace(old, new))

    with pytest.raises(ConfigError) as refused:
        load_experiment(str(path))

    assert said in str(refused.value)
    assert "\n" not in str(refused.value)
    if "is not one of the robots" not in said and "labs" not in said and "no such file" not in said:
        assert str(refused.value).startswith(f"{path}: ")


def test_a_mistake_in_the_robot_or_the_lab_is_told_with_that_file(write, short, robot_text):
    robot = write(robot_text.replace("bending_stiffness = 0.048", "bending_stiffness = -0.048"), "robot")
    lab = write("[tracker]\nrate = 0.0\n", "lab")

    with pytest.raises(ConfigError, match=r"robot\.toml: tube 'outer': bending_stiffness -0\.048 N m\^2 must be "):
        load_experiment(str(write(f'robot = "{robot}"\n' + short)))
    with pytest.raises(ConfigError, match=r"lab\.toml: tracker\.rate = 0\.0: Input should be greater than 0"):
        load_experiment(str(write(f'lab = "{lab}"\n' + short)))


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ("[plant.tubes.middle]\nstiffness = 0.1", "plant.tubes.middle: robot 'paper' has no such part; it has inner"),
        ("[plant.play]\nelbow = 0.1", "plant.play.elbow: robot 'paper' has no such part; it has outer_rotation"),
        ("[plant]\nvary = 0.6", "plant.vary = 0.6: Input should be less than 0.5"),
        ("[plant.tubes.inner]\nstiffness = -1.0", "plant.tubes.inner.stiffness = -1.0: "),
        ('devices = "perfect"', "devices = 'perfect': "),
    ],
)
def test_a_lab_that_does_not_fit_the_robot_is_refused(write, short, table, said):
    lab = write(table, "lab")

    with pytest.raises(ConfigError) as refused:
        load_experiment(str(write(f'lab = "{lab}"\n' + short)))
    assert str(refused.value).startswith(f"{lab}: {said}")


FAULT = '\n[[faults]]\nkind = "{}"\ndevice = "{}"\nat = 0.2\nduration = 0.3\n'


def test_faults_are_part_of_an_experiment(write, short):
    text = short + FAULT.format("mute", "stages") + FAULT.format("lose_tool", "tracker")
    (case,) = load_experiment(str(write(text))).cases

    assert [(fault.kind, fault.at, fault.duration) for fault in case.file.faults] == [
        ("mute", 0.2, 0.3),
        ("lose_tool", 0.2, 0.3),
    ]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (FAULT.format("stall", "elbow"), "faults.0.device = 'elbow': expected one of stages, tracker, sensors"),
        (FAULT.format("stall", "tracker"), "faults.0.kind = 'stall': to 'tracker' can happen"),
        (FAULT.format("explode", "tracker"), "faults.0.kind = 'explode'"),
        (FAULT.format("restart", "tracker"), "'restart' happens at once"),
    ],
)
def test_a_fault_that_cannot_happen_is_refused(write, short, text, said):
    with pytest.raises(ConfigError, match=re.escape(said)):
        load_experiment(str(write(short + text)))


def test_ideal_devices_have_no_faults(write, short):
    with pytest.raises(ConfigError, match="the devices of lab 'ideal' are ideal"):
        load_experiment(str(write('lab = "ideal"\n' + short + FAULT.format("mute", "stages"))))


FAST = '[load]\nkind = "trapezoid"\nmagnitude = 0.5\nrise = 0.5\nstart = 0.3\n'


def test_a_load_is_warned_of_with_the_time_and_the_limit_and_not_refused(write, short):
    text = short.replace("duration = 1.0", "duration = 3.0") + '[controller]\nstrategy = "dual_layer"\n' + FAST
    slow = text.replace("rise = 0.5", "rise = 60.0")
    (fast,), (steady,) = (load_experiment(str(write(each))).cases for each in (text, slow))

    (warning,) = fast.warnings
    said = r"load trapezoid is more than the joints can make up for: hold cannot be followed: at 0\.\d+ s .* mm off"
    assert re.match(said, warning)
    assert "speed of " in warning
    assert steady.warnings == ()


def test_a_load_on_a_tip_that_is_not_held_is_not_warned_of(write, short):
    text = short + '[controller]\nstrategy = "unloaded_jacobian"\n' + FAST
    (case,) = load_experiment(str(write(text))).cases

    assert case.warnings == ()


def test_a_motion_that_is_too_fast_is_refused_with_and_without_a_load(write, short):
    fast = short.replace('kind = "hold"', 'kind = "circle"\nradius = 0.015\nperiod = 3.0').replace("= 1.0", "= 9.0")
    for load in ("", FAST):
        with pytest.raises(ConfigError, match=r"circle cannot be followed: at .* because of speed of"):
            load_experiment(str(write(fast + load)))


def test_errors_count_from_the_loads_onset_or_the_settling_time(write, short):
    for settling, counted in (("0.1", 0.1), ("0.7", 0.3)):
        (case,) = load_experiment(str(write(short.replace("settling = 0.0", f"settling = {settling}") + FAST))).cases
        assert case.file.counted_from == counted


def test_files_that_an_experiment_names_are_beside_it(write, short, robot_text, tmp_path, monkeypatch):
    place = tmp_path / "deep"
    place.mkdir()
    (place / "mine.toml").write_text(robot_text.replace('name = "paper"', 'name = "mine"'), encoding="utf-8")
    (place / "noisy.toml").write_text("[tracker]\nnoise = 0.5e-3\n", encoding="utf-8")
    (place / "path.csv").write_text("time,x,y,z\n0,0,0,0\n5,0,0,0.001\n", encoding="utf-8")
    motion = '[trajectory]\nkind = "csv"\nfile = "path.csv"\n'
    text = 'robot = "mine.toml"\nlab = "noisy.toml"\n' + short.replace('[trajectory]\nkind = "hold"\n', motion)
    (place / "own.toml").write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    (case,) = load_experiment("deep/own.toml").cases

    assert case.robot.name == "mine"
    assert case.lab.tracker.noise == 0.5e-3
    assert case.file.trajectory.file == "deep/path.csv"


def test_changes_are_laid_on_top_of_every_case(write, short):
    path = write(short + "[cases.one]\nduration = 2.0\n[cases.two.controller]\nk1 = 4.0\nk2 = 4.0\n")
    one, two = load_experiment(str(path), {"duration": 0.5, "controller": {"k1": 1.0}}).cases

    assert (one.file.duration, two.file.duration) == (0.5, 0.5)
    assert (one.file.controller.k1, one.file.controller.k2) == (1.0, 2.5)
    assert (two.file.controller.k1, two.file.controller.k2) == (1.0, 4.0)


def test_an_own_experiment_that_was_edited_is_offered_as_it_is_now(short, tmp_path, monkeypatch):
    monkeypatch.setenv(OWN_EXPERIMENTS, str(tmp_path))
    text = short.replace('"short"', '"first"')
    (tmp_path / "own.toml").write_text(text, encoding="utf-8")
    assert offered("own").title == "first"
    (tmp_path / "own.toml").write_text(text.replace("first", "second"), encoding="utf-8")
    assert offered("own").title == "second"
    assert offered("fig7") is offered("fig7")
    # One's own goes before the station's, whether that has been asked for or not.
    (tmp_path / "fig7.toml").write_text(text.replace("first", "mine"), encoding="utf-8")
    assert offered("fig7").title == "mine"
