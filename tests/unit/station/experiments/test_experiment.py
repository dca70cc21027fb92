"""An invalid file is refused in one line before anything runs; a load that is too fast gives a warning."""

import re

import pytest

from station.config.strict import EXPERIMENTS_VARIABLE, ConfigError
from station.experiments.experiment import load_experiment, offered_experiment
from station.lab.simulated_stages import lab_latency


@pytest.mark.parametrize(
    ("old", "new", "message"),
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
        (
            'kind = "hold"',
            'kind = "hold"\n[controller]\nstrategy = "magic"',
            "controller.strategy = 'magic' is not one of",
        ),
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
def test_an_invalid_experiment_is_refused_with_a_message_of_one_line(write, short, old, new, message):
    assert short.count(old) == 1
    path = write(short.replace(old, new))

    with pytest.raises(ConfigError) as refused:
        load_experiment(str(path))

    assert message in str(refused.value)
    assert "\n" not in str(refused.value)
    if "is not one of the robots" not in message and "labs" not in message and "no such file" not in message:
        assert str(refused.value).startswith(f"{path}: ")


def test_an_experiment_with_an_invalid_robot_or_lab_is_refused_naming_the_invalid_file(write, short, robot_text):
    robot = write(robot_text.replace("bending_stiffness = 0.048", "bending_stiffness = -0.048"), "robot")
    lab = write("[tracker]\nrate = 0.0\n", "lab")

    with pytest.raises(ConfigError, match=r"robot\.toml: tubes\.1\.bending_stiffness = -0\.048: Input should"):
        load_experiment(str(write(f'robot = "{robot}"\n' + short)))
    with pytest.raises(ConfigError, match=r"lab\.toml: tracker\.rate = 0\.0: Input should be greater than 0"):
        load_experiment(str(write(f'lab = "{lab}"\n' + short)))


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("[plant.tubes.middle]\nstiffness = 0.1", "plant.tubes.middle: robot 'paper' has no such part; it has inner"),
        ("[plant.play]\nelbow = 0.1", "plant.play.elbow: robot 'paper' has no such part; it has outer_rotation"),
        ("[plant]\nvary = 0.6", "plant.vary = 0.6: Input should be less than 0.5"),
        ("[plant.tubes.inner]\nstiffness = -1.0", "plant.tubes.inner.stiffness = -1.0: "),
        ('devices = "perfect"', "devices = 'perfect': "),
    ],
)
def test_an_experiment_whose_lab_does_not_fit_its_robot_is_refused(write, short, table, message):
    lab = write(table, "lab")

    with pytest.raises(ConfigError) as refused:
        load_experiment(str(write(f'lab = "{lab}"\n' + short)))
    assert str(refused.value).startswith(f"{lab}: {message}")


FAULT = '\n[[faults]]\nkind = "{}"\ndevice = "{}"\nat = 0.2\nduration = 0.3\n'


def test_faults_in_an_experiment_file_are_read_into_the_case(write, short):
    text = short + FAULT.format("mute", "stages") + FAULT.format("lose_tool", "tracker")
    (case,) = load_experiment(str(write(text))).cases

    assert [(fault.kind, fault.at, fault.duration) for fault in case.file.faults] == [
        ("mute", 0.2, 0.3),
        ("lose_tool", 0.2, 0.3),
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (FAULT.format("stall", "elbow"), "faults.0.device = 'elbow': expected one of stages, tracker, sensors"),
        (FAULT.format("stall", "tracker"), "faults.0.kind = 'stall': 'tracker' can have only the faults"),
        (FAULT.format("explode", "tracker"), "faults.0.kind = 'explode'"),
        (FAULT.format("restart", "tracker"), "'restart' happens at once"),
    ],
)
def test_an_experiment_with_an_impossible_device_fault_is_refused(write, short, text, message):
    with pytest.raises(ConfigError, match=re.escape(message)):
        load_experiment(str(write(short + text)))


def test_faults_are_refused_in_a_lab_with_ideal_devices(write, short):
    with pytest.raises(ConfigError, match="the devices of lab 'ideal' are ideal"):
        load_experiment(str(write('lab = "ideal"\n' + short + FAULT.format("mute", "stages"))))


FAST = '[load]\nkind = "trapezoid"\nmagnitude = 0.5\nrise = 0.5\nstart = 0.3\n'


def test_a_too_fast_load_gives_a_warning_with_time_and_limit_and_no_refusal(write, short):
    text = short.replace("duration = 1.0", "duration = 3.0") + '[controller]\nstrategy = "dual_layer"\n' + FAST
    slow = text.replace("rise = 0.5", "rise = 60.0")
    (fast,), (steady,) = (load_experiment(str(write(each))).cases for each in (text, slow))

    (warning,) = fast.warnings
    message = r"the joints cannot compensate load trapezoid: hold cannot be followed: at 0\.\d+ s .* mm off"
    assert re.match(message, warning)
    assert "speed of " in warning
    assert steady.warnings == ()


def test_a_load_gives_no_warning_when_the_tip_position_is_not_controlled(write, short):
    text = short + '[controller]\nstrategy = "unloaded_jacobian"\n' + FAST
    (case,) = load_experiment(str(write(text))).cases

    assert case.warnings == ()


def test_a_motion_that_is_too_fast_for_the_joints_is_refused_with_and_without_a_load(write, short):
    fast = short.replace('kind = "hold"', 'kind = "circle"\nradius = 0.015\nperiod = 3.0').replace("= 1.0", "= 9.0")
    for load in ("", FAST):
        with pytest.raises(ConfigError, match=r"circle cannot be followed: at .* because of speed of"):
            load_experiment(str(write(fast + load)))


def test_errors_count_from_the_earlier_of_load_onset_and_settling_time(write, short):
    for settling, counted in (("0.1", 0.1), ("0.7", 0.3)):
        (case,) = load_experiment(str(write(short.replace("settling = 0.0", f"settling = {settling}") + FAST))).cases
        assert case.file.counted_from == counted


def test_file_names_in_an_experiment_are_relative_to_its_folder(write, short, robot_text, tmp_path, monkeypatch):
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


def test_an_edited_user_experiment_is_read_again(short, tmp_path, monkeypatch):
    monkeypatch.setenv(EXPERIMENTS_VARIABLE, str(tmp_path))
    text = short.replace('"short"', '"first"')
    (tmp_path / "own.toml").write_text(text, encoding="utf-8")
    assert offered_experiment("own").title == "first"
    (tmp_path / "own.toml").write_text(text.replace("first", "second"), encoding="utf-8")
    assert offered_experiment("own").title == "second"
    assert offered_experiment("fig7") is offered_experiment("fig7")
    assert offered_experiment("fig7", check_motions=False) is not offered_experiment("fig7")
    # A user's experiment takes precedence over a preset, also after the preset was loaded.
    (tmp_path / "fig7.toml").write_text(text.replace("first", "mine"), encoding="utf-8")
    assert offered_experiment("fig7").title == "mine"


def test_description_of_an_experiment_does_not_check_its_motions(short, write):
    path = write(short.replace('kind = "hold"', 'kind = "circle"\nradius = 0.09\nperiod = 20.0'))
    with pytest.raises(ConfigError, match="cannot be followed"):
        load_experiment(str(path))
    (case,) = load_experiment(str(path), check_motions=False).cases
    assert case.file.trajectory.kind == "circle"


def test_controller_of_an_experiment_plans_for_the_latency_of_the_stages_in_its_lab():
    for case in offered_experiment("stages", check_motions=False).cases:
        actuation = case.controller.estimator.actuation
        assert (actuation.command_interval, actuation.transport_delay) == lab_latency(case.lab.stages, case.robot)
