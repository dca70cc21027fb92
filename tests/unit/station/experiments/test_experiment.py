"""A file that cannot be run is refused before anything runs, in one line; a load that is too fast is warned of."""

import re

import pytest

from station.config.strict import OWN_EXPERIMENTS, ConfigError
from station.experiments.experiment import load_experiment, offered


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
        (
            'title = "short"',
            'title = "short"\nrobot = "snake"',
            "'snake' is not one of the robots: balanced_pair, nylon, paper",
        ),
        (
            'title = "short"',
            'title = "short"\nlab = "moon"',
            "'moon' is not one of the labs: breathing, distorted, gentle, heartbeat, ideal, pointing, realistic",
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
