"""Simulated devices: hold, transport, quantisation, ramps; frames and latency; noise, counts, drift."""

import math

import numpy as np
import pytest

from station.lab.config import BaseSensorConfig, LineConfig, TrackerConfig
from station.lab.devices import SimulatedBaseSensors, SimulatedStages, SimulatedTracker

START = np.array([0.0, math.pi / 2, -0.100])
TICK = 0.002
IDEAL = LineConfig(hold=0.0, transport=0.0, quantised=False, ramps=False)
#: Size of a speed unit of each stage: 9.375 microsteps of 0.000234375 deg and of 0.49609375 um [rad/s, m/s].
UNITS = np.array([math.radians(9.375 * 0.000234375)] * 2 + [9.375 * 0.49609375e-6])


@pytest.fixture
def stages(paper):
    """The paper's three stages on a line that is ideal but for what is given."""

    def make(at: np.ndarray = START, **changes: object) -> SimulatedStages:
        return SimulatedStages(paper.joints, IDEAL.model_copy(update=changes), at)

    return make


def drive(stages: SimulatedStages, ticks: int, velocities, first: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Command `velocities(time)` at every tick; what is sent after it, and the true positions at it."""
    sent, positions = [], []
    for tick in range(first, first + ticks):
        now = tick * TICK
        stages.advance(max(0.0, now - TICK), now)
        positions.append(stages.positions.copy())
        stages.command(np.asarray(velocities(now)), now)
        sent.append(stages.poll(now).sent)
    return np.array(sent), np.array(positions)


def changes(sent: np.ndarray) -> list[np.ndarray]:
    """For each axis the ticks at which what is sent changes."""
    return [np.flatnonzero(np.diff(axis)) + 1 for axis in sent.T]


def test_each_axis_takes_a_command_every_25_ms(stages):
    sent, _ = drive(stages(hold=0.025), 5000, lambda now: np.array([0.01, 0.02, 0.001]) * (1.0 + now))

    for axis in changes(sent):
        assert len(axis) == pytest.approx(400, abs=1)  # 10 s / 25 ms
        assert set(np.diff(axis)) == {12, 13}  # 24 and 26 ms: the ticks nearest to the grid of 25 ms


def test_the_axes_take_turns(stages):
    sent, _ = drive(stages(hold=0.025), 500, lambda now: np.array([0.01, 0.02, 0.001]) * (1.0 + now))

    together = [set(axis.tolist()) for axis in changes(sent)]
    assert not together[0] & together[1]
    assert not together[1] & together[2]
    assert not together[0] & together[2]


def test_after_a_pause_the_turns_begin_anew_and_no_axis_is_served_twice_at_once(stages):
    line = stages(hold=0.025)
    line.advance(0.0, 2.0)
    sent, _ = drive(line, 200, lambda now: np.array([0.01, 0.02, 0.001]) * (1.0 + now), first=1000)

    assert sent[0].nonzero()[0].tolist() == [0]  # the first axis at once, the others in their turn
    for axis in changes(sent):
        assert np.diff(axis).min() >= 12


def test_an_axis_gets_the_latest_command_when_its_turn_comes(stages):
    def ramp(now: float) -> np.ndarray:
        return np.array([0.01, 0.02, 0.001]) * (1.0 + now)

    sent, _ = drive(stages(hold=0.025), 500, ramp)

    # The turns of axis i come at i/3 of 25 ms and every 25 ms from there; commands come every 2 ms.
    for axis, ticks in enumerate(changes(sent)):
        for turn, tick in enumerate(ticks, 0 if axis else 1):
            due = 0.025 * (turn + axis / 3.0)
            assert sent[tick, axis] == ramp(TICK * math.floor(due / TICK + 1e-6))[axis]


def test_a_command_given_once_reaches_every_axis_in_its_turn(stages):
    line = stages(hold=0.024)
    line.command(np.array([0.1, 0.1, 0.01]), 0.0)
    line.advance(0.0, 0.1)

    assert line.positions - START == pytest.approx([0.1 * 0.100, 0.1 * 0.092, 0.01 * 0.084])


def test_a_command_takes_effect_after_the_transport(stages):
    velocity = np.array([0.1, -0.2, 0.003])
    _, positions = drive(stages(transport=0.012), 20, lambda _: velocity)

    for tick, position in enumerate(positions):
        assert position - START == pytest.approx(velocity * max(0.0, tick * TICK - 0.012), abs=1e-12)


@pytest.mark.parametrize("step", [0.0005, 0.002, 0.0037, 0.031])
def test_the_time_of_an_effect_does_not_depend_on_how_time_is_cut(stages, step):
    line = stages(transport=0.012, ramps=True)
    line.command(np.array([0.3, 0.0, 0.0]), 0.0)
    time = 0.0
    while time < 0.2:
        line.advance(time, min(time + step, 0.2))
        time = min(time + step, 0.2)

    # 12 ms later 0.3 rad/s are reached at 1.745 rad/s^2: v t - v^2 / 2a
    assert line.positions[0] == pytest.approx(0.3 * 0.188 - 0.3**2 / (2.0 * math.radians(100.0)))


def test_speeds_are_sent_in_units_of_the_stage(stages):
    line = stages(quantised=True)
    line.command(np.array([math.radians(3.0), -math.radians(3.0), 0.005]), 0.0)

    # 3 deg/s = 1365.33 units, 5 mm/s = 1075.07 units
    assert line.poll(0.0).sent / UNITS == pytest.approx([1365.0, -1365.0, 1075.0], abs=1e-9)
    assert math.degrees(line.poll(0.0).sent[0]) == pytest.approx(2.999267578125)


@pytest.mark.parametrize(("units", "sent"), [(0.4, 0.0), (0.6, 1.0), (-0.4, 0.0), (-1.6, -2.0)])
def test_a_speed_is_rounded_to_the_nearest_unit_either_way(stages, units, sent):
    line = stages(quantised=True)
    line.command(units * UNITS, 0.0)

    assert line.poll(0.0).sent / UNITS == pytest.approx(np.full(3, sent))


def test_positions_are_read_in_microsteps(stages):
    line = stages(START + np.array([1e-6, 2e-6, 0.2e-6]), quantised=True)
    steps = line.poll(0.0).positions / [math.radians(0.000234375)] * [1.0, 1.0, 0.0]

    assert steps == pytest.approx(np.round(steps), abs=1e-6)
    # -0.0999998 m are -201574.4 steps
    assert line.poll(0.0).positions[2] / 0.49609375e-6 == pytest.approx(-201574.0, abs=1e-6)
    assert np.abs(line.poll(0.0).positions - line.positions).max() <= 0.5 * math.radians(0.000234375)


def test_a_speed_is_cut_to_the_stages_limit(stages):
    line = stages()
    line.command(np.array([10.0, -10.0, 1.0]), 0.0)

    assert line.poll(0.0).sent == pytest.approx([math.radians(20.0), -math.radians(20.0), 0.020])


def test_speed_changes_at_the_stages_acceleration(stages):
    _, positions = drive(stages(ramps=True), 251, lambda _: [math.radians(20.0), 0.0, -0.020])
    turned, slid = np.degrees(positions[:, 0]), 1e3 * (positions[:, 2] - START[2])

    # 100 deg/s^2 up to 20 deg/s: 0.5 deg after 0.1 s, 2 deg after 0.2 s, then 2 deg every 0.1 s; the same in mm
    for tick, way in {50: 0.5, 100: 2.0, 150: 4.0, 250: 8.0}.items():
        assert turned[tick] == pytest.approx(way)
        assert slid[tick] == pytest.approx(-way)


def test_a_reversal_takes_as_long_as_the_acceleration_says(stages):
    line = stages(ramps=True)
    drive(line, 101, lambda _: [math.radians(10.0), 0.0, 0.0])
    begin = line.positions[0]
    _, positions = drive(line, 101, lambda _: [-math.radians(10.0), 0.0, 0.0], first=101)

    # The tick that commands it is the 100th after the last advance; 0.1 s up to rest, 0.1 s back to where it began.
    moved = np.degrees(positions[:, 0] - begin)
    assert moved.max() == pytest.approx(0.02 + 0.5, abs=1e-9)
    assert moved[100] == pytest.approx(0.02, abs=1e-9)


def test_no_stage_leaves_its_travel_and_one_that_hit_the_end_starts_back_from_rest(stages):
    line = stages(np.array([0.0, 0.0, -0.010]), ramps=True)
    _, out = drive(line, 600, lambda _: [0.0, 0.0, 0.020])
    _, back = drive(line, 51, lambda _: [0.0, 0.0, -0.010], first=600)

    assert out[:, 2].max() == -0.005
    assert out[-1, 2] == -0.005
    # the first tick of `back` only commands; 0.1 s at 0.1 m/s^2 make 0.5 mm
    assert 1e3 * (back[50, 2] + 0.005) == pytest.approx(-0.5)


def test_a_stop_does_not_wait_for_its_turn(stages):
    line = stages(hold=0.025, transport=0.012)
    drive(line, 101, lambda _: [0.1, 0.1, 0.01])
    line.command(np.zeros(3), 0.2005)
    waiting = line.poll(0.2005).sent
    line.stop(0.2005)

    assert waiting.any()  # an ordinary command of zero waits for the axes' turns
    assert not line.poll(0.2005).sent.any()
    line.advance(0.2, 0.2125)
    stopped = line.positions.copy()
    line.advance(0.2125, 1.0)
    assert stopped == pytest.approx(line.positions)


def test_what_was_on_its_way_when_the_stop_came_is_not_carried_out(stages):
    line = stages(transport=0.012)
    line.command(np.array([0.1, 0.1, 0.01]), 0.0)
    line.stop(0.002)
    line.advance(0.0, 1.0)

    assert line.positions == pytest.approx(START)


def test_a_reading_does_not_change_when_the_stages_go_on(stages):
    line = stages()
    before = line.poll(0.0)
    line.command(np.array([0.1, 0.1, 0.01]), 0.0)
    line.advance(0.0, 1.0)

    assert before.positions == pytest.approx(START)
    assert not before.sent.any()


def tracker(**changes: float) -> SimulatedTracker:
    return SimulatedTracker(TrackerConfig(**changes), np.random.default_rng(0))


def watch(tracker: SimulatedTracker, ticks: int, tip) -> list[tuple[float, int, float, np.ndarray]]:
    """Poll at every tick while the tip moves: when a frame arrived, its number, time and position."""
    seen = []
    for tick in range(ticks):
        now, before = tick * TICK, max(0, tick - 1) * TICK
        tracker.advance(before, now, np.asarray(tip(before)), np.asarray(tip(now)))
        if (frame := tracker.poll(now)) is not None:
            seen.append((now, *frame))
    return seen


def test_frames_come_40_times_a_second_and_24_ms_late():
    seen = watch(tracker(), 1000, lambda _: np.zeros(3))

    assert [number for _, number, _, _ in seen] == list(range(80))[: len(seen)]
    assert len(seen) == 80 - 1  # the last one is still on its way
    for arrival, number, time, _ in seen:
        assert time == pytest.approx(number / 40.0)
        assert 0.0 <= arrival - (time + 0.024) + 1e-9 < TICK  # the first tick at or after it


def test_a_frame_shows_the_tip_of_its_own_moment():
    seen = watch(tracker(noise=0.0), 500, lambda now: np.array([0.010, -0.020, 0.005]) * now)

    for _, number, _, position in seen:
        assert position == pytest.approx(np.array([0.010, -0.020, 0.005]) * number / 40.0, abs=1e-12)


def test_frames_that_were_not_fetched_are_overtaken_by_the_newest():
    slow = tracker()
    slow.advance(0.0, 1.0, np.zeros(3), np.zeros(3))
    newest = slow.poll(1.0)

    assert newest is not None
    assert newest.frame == 39  # taken at 0.975 s; the one of 1.0 s is on its way
    assert slow.poll(1.0) is None


def test_the_trackers_noise_is_white_and_a_tenth_of_a_millimetre_an_axis():
    steady = tracker(latency=0.0)
    tip = np.array([0.03, -0.04, 0.19])
    frames = []
    for number in range(8000):
        steady.advance((number - 1) / 40.0, number / 40.0, tip, tip)
        frame = steady.poll(number / 40.0)
        assert frame is not None
        frames.append(frame.position)
    noise = np.array(frames) - tip

    # of 8000: deviation within 0.8 % (1 sigma), mean within 1.1 um, correlations within 0.011
    assert noise.std(axis=0) == pytest.approx(np.full(3, 1e-4), rel=0.03)
    assert np.abs(noise.mean(axis=0)).max() < 4e-6
    assert max(abs(np.corrcoef(axis[1:], axis[:-1])[0, 1]) for axis in noise.T) < 0.04
    assert np.abs(np.corrcoef(noise.T) - np.eye(3)).max() < 0.04


QUIET = dict.fromkeys(
    ("force_noise", "moment_noise", "force_count", "moment_count", "drift", "force_offset", "moment_offset"), 0.0
)


def sensors(seed: int = 0, **changes: float) -> SimulatedBaseSensors:
    return SimulatedBaseSensors(BaseSensorConfig(**{**QUIET, **changes}), 2, np.random.default_rng(seed))


def test_without_flaws_a_sensor_reads_what_it_feels():
    wrenches = np.arange(12.0).reshape(2, 6)
    ideal = sensors()
    ideal.advance(wrenches)

    assert ideal.poll(1.5).time == 1.5
    assert ideal.poll(1.5).wrenches == pytest.approx(wrenches)


def test_each_sample_has_white_noise_of_its_own():
    noisy = sensors(force_noise=0.02, moment_noise=0.2e-3)
    samples = np.array([noisy.poll(0.002 * tick).wrenches for tick in range(8000)]).reshape(8000, 12)
    deviations = [0.02, 0.02, 0.02, 0.2e-3, 0.2e-3, 0.2e-3] * 2

    assert samples.std(axis=0) == pytest.approx(deviations, rel=0.03)
    assert np.abs(samples.mean(axis=0) / deviations).max() < 0.04
    assert np.abs(np.corrcoef(samples.T) - np.eye(12)).max() < 0.05
    assert max(abs(np.corrcoef(axis[1:], axis[:-1])[0, 1]) for axis in samples.T) < 0.05


def test_readings_come_in_whole_counts_of_the_default_sensor():
    default = SimulatedBaseSensors(BaseSensorConfig(), 2, np.random.default_rng(0))
    readings = np.array([default.poll(0.002 * tick).wrenches for tick in range(200)])
    counts = readings / ([1.0 / 256.0] * 3 + [0.05e-3] * 3)

    assert counts == pytest.approx(np.round(counts), abs=1e-6)


@pytest.mark.parametrize(("force", "moment"), [(0.25, 0.0), (0.0, 0.25), (0.25, 0.25)])
def test_quantisation_is_to_the_nearest_count_of_each_kind_on_its_own(force, moment):
    coarse = sensors(force_count=force, moment_count=moment)
    coarse.advance(np.full((2, 6), 0.6))
    reading = coarse.poll(0.0).wrenches

    assert reading[:, :3] == pytest.approx(np.full((2, 3), 0.5 if force else 0.6))
    assert reading[:, 3:] == pytest.approx(np.full((2, 3), 0.5 if moment else 0.6))


def test_forces_drift_by_5_mn_a_minute_either_way_and_moments_do_not():
    ways = set()
    for seed in range(10):
        slow = sensors(seed, drift=BaseSensorConfig().drift)
        first, later, last = (slow.poll(60.0 * minute).wrenches for minute in (0.0, 1.0, 3.0))
        assert np.abs(later - first)[:, :3] == pytest.approx(np.full((2, 3), 0.005))
        assert last - first == pytest.approx(3.0 * (later - first))
        assert not (later - first)[:, 3:].any()
        ways |= set(np.sign((later - first)[:, :3]).ravel())
    assert ways == {-1.0, 1.0}


def test_an_offset_stays_within_its_bound_stays_put_and_comes_from_the_seed():
    offsets = []
    for seed in range(30):
        one = sensors(seed, force_offset=1.0, moment_offset=10e-3)
        offsets.append(one.poll(0.0).wrenches)
        assert one.poll(100.0).wrenches == pytest.approx(offsets[-1])
        assert sensors(seed, force_offset=1.0, moment_offset=10e-3).poll(0.0).wrenches == pytest.approx(offsets[-1])
    drawn = np.abs(offsets) / ([1.0] * 3 + [10e-3] * 3)

    assert drawn.max() <= 1.0
    assert drawn.max(axis=0).min() > 0.8
