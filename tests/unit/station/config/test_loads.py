"""The forces of simulated loads equal values computed by hand."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from core.errors import ContractError
from station.config.loads import (
    HungWeightLoad,
    Load,
    NoLoad,
    RaisedCosineLoad,
    SineLoad,
    SphereLoad,
    WallLoad,
    elastic_force,
    force_of,
)
from station.config.strict import ConfigError, Strict, check


class Holder(Strict):
    load: Load


def load(**table: object) -> Load:
    return check(Holder, {"load": table}, "file").load


CONSTANT = {"kind": "constant", "magnitude": 0.5}
SINE = {"kind": "sine", "amplitude": 0.2, "frequency": 0.05}
RAISED = {"kind": "raised_cosine", "peak": 0.5, "period": 20.0}
RAMPS = {"kind": "ramps", "times": [5.0, 7.5, 15.0, 17.5], "magnitudes": [0.0, 0.5, 0.5, 0.0]}
LIFTED = {"kind": "trapezoid", "magnitude": 0.5, "rise": 2.0, "fall": 0.5, "stay": 4.0, "start": 1.0}
STEP = {"kind": "trapezoid", "magnitude": 0.5, "rise": 0.0}
TAP = {"kind": "tap", "peak": 0.4, "duration": 0.06, "start": 1.0}


@pytest.mark.parametrize(
    ("table", "by_time"),
    [
        ({"kind": "none"}, {0.0: 0.0, 7.0: 0.0}),
        (CONSTANT, {0.0: 0.5, 1e5: 0.5}),
        # f_x = 0.2 sin(2 pi 0.05 t) has peaks at a quarter and at three quarters of 20 s
        (SINE, {0.0: 0.0, 5.0: 0.2, 10.0: 0.0, 15.0: -0.2, 5.0 / 3.0: 0.1, 25.0: 0.2}),
        # 0.25 (1 - cos(2 pi t / 20)) is 0.5 N at half the period and 0.25 N at a quarter of the period
        (RAISED, {0.0: 0.0, 5.0: 0.25, 10.0: 0.5, 15.0: 0.25, 20.0: 0.0, 30.0: 0.5, 20.0 / 6.0: 0.125}),
        (RAMPS, {0.0: 0.0, 4.99: 0.0, 5.0: 0.0, 6.25: 0.25, 7.5: 0.5, 12.0: 0.5, 16.25: 0.25, 17.5: 0.0, 99.0: 0.0}),
        (LIFTED, {0.0: 0.0, 1.0: 0.0, 2.0: 0.25, 3.0: 0.5, 6.9: 0.5, 7.0: 0.5, 7.25: 0.25, 7.5: 0.0, 99.0: 0.0}),
        (STEP, {0.0: 0.5, 1e-9: 0.5, 1e5: 0.5}),
        ({**STEP, "stay": 1.0, "start": 2.0}, {1.999: 0.0, 2.0: 0.5, 2.999: 0.5, 3.0: 0.0}),
        # half a sine wave has half of its peak at a sixth and at five sixths of its duration
        (TAP, {0.999: 0.0, 1.01: 0.2, 1.03: 0.4, 1.05: 0.2, 1.06: 0.0, 2.0: 0.0}),
        ({"kind": "ramps", "times": [2.0], "magnitudes": [0.3]}, {0.0: 0.0, 1.999: 0.0, 2.0: 0.3, 50.0: 0.3}),
        ({"kind": "ramps", "times": [0.0, 1.0], "magnitudes": [0.4, -0.4]}, {0.0: 0.4, 0.25: 0.2, 0.75: -0.2, 2: -0.4}),
    ],
)
def test_load_equals_its_closed_form_along_gravity(table, by_time):
    for time, force in by_time.items():
        assert load(**table).force(time) == pytest.approx([force, 0.0, 0.0], abs=1e-15), f"at {time} s"


@pytest.mark.parametrize("table", [{"kind": "none"}, CONSTANT, SINE, RAISED, RAMPS, LIFTED, STEP, TAP])
def test_load_is_zero_before_the_start(table):
    for time in (-1e-9, -0.5, -13.0):
        assert not load(**table).force(time).any()


@pytest.mark.parametrize(
    ("table", "changes"),
    [
        ({"kind": "none"}, ()),
        (CONSTANT, (0.0,)),
        (SINE, (0.0,)),
        (RAISED, (0.0,)),
        (RAMPS, (5.0, 15.0)),
        (LIFTED, (1.0, 7.0)),
        (STEP, (0.0,)),
        (TAP, (1.0,)),
        ({"kind": "hung_weight", "weight": 0.2, "start": 3.0}, (3.0,)),
        # the load jumps at 2 s and is constant until 4 s, where a ramp starts that continues into another ramp
        ({"kind": "ramps", "times": [2.0, 4.0, 5.0, 6.0], "magnitudes": [0.3, 0.3, 0.4, 0.1]}, (2.0, 4.0)),
        ({"kind": "ramps", "times": [2.0, 4.0], "magnitudes": [0.0, 0.0]}, ()),
        ({"kind": "ramps", "times": [2.0, 4.0], "magnitudes": [0.1, 0.3]}, (2.0,)),
    ],
)
def test_load_reports_the_times_of_its_changes(table, changes):
    found = load(**table)

    assert found.changes == changes
    assert found.onset == (changes[0] if changes else math.inf)
    # The load is constant just before each reported time, and changes soon after it.
    for time in changes:
        assert found.force(time - 1e-6) == pytest.approx(found.force(time - 1e-3), abs=1e-12)
        assert np.abs(found.force(time + 0.02) - found.force(time - 1e-6)).max() > 0.0


def test_lowering_of_a_hung_weight_may_start_later() -> None:
    now, later = HungWeightLoad(weight=0.2, lowering=1.0), HungWeightLoad(weight=0.2, lowering=1.0, start=3.0)
    for time in (-1.0, 0.0, 0.5, 1.7):
        assert later.force(time + 3.0) == pytest.approx(now.force(time), abs=1e-12)


def test_length_of_its_direction_does_not_change_a_load():
    assert load(**CONSTANT, direction=[0, -30, 40]).force(1.0) == pytest.approx([0.0, -0.3, 0.4])
    assert load(**SINE, direction=[0, 0, -1e-6]).force(5.0) == pytest.approx([0.0, 0.0, -0.2])


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({**CONSTANT, "direction": [0.0, 0.0, 0.0]}, "load.direction = [0.0, 0.0, 0.0]: the length of a direction"),
        ({**RAISED, "amplitude": 0.2}, "unknown key 'load.amplitude'"),
        ({"kind": "ramps", "times": [1.0, 2.0], "magnitudes": [0.1]}, "2 times but 1 magnitudes"),
        ({"kind": "ramps", "times": [2.0, 1.0], "magnitudes": [0.1, 0.2]}, "times must increase"),
        ({"kind": "ramps", "times": [1.0] * 10_001, "magnitudes": [0.1]}, "at most 10000 items after"),
        ({"kind": "ramps", "times": [-1.0, 1.0], "magnitudes": [0.1, 0.2]}, "load.times.0 = -1.0: "),
        ({"kind": "wind"}, "load = {'kind': 'wind'}: "),
    ],
)
def test_invalid_load_is_refused_by_key_and_value(table, message):
    with pytest.raises(ConfigError) as refused:
        check(Holder, {"load": table}, "file")

    assert str(refused.value).startswith("file: ")
    assert message in str(refused.value)


def test_weight_on_a_rubber_band_oscillates_at_its_frequency_and_decays() -> None:
    load = HungWeightLoad(weight=0.2, lowering=1.3)
    rate = 2.0 * math.pi * 2.0
    times = np.linspace(0.0, 3.0, 301)
    # The reference is an oscillator of 2 Hz with 5 % damping, driven by the part of the weight that the hand released.
    answer = solve_ivp(
        lambda t, y: [y[1], rate**2 * (0.2 * min(t / 1.3, 1.0) - y[0]) - 2.0 * 0.05 * rate * y[1]],
        (0.0, 3.0), [0.0, 0.0], t_eval=times, rtol=1e-10, atol=1e-12, max_step=0.01,
    )  # fmt: skip
    forces = np.array([load.force(time)[0] for time in times])
    assert np.abs(forces - answer.y[0]).max() < 1e-5
    assert np.ptp(forces[times > 1.5]) > 0.01
    assert load.force(-1.0).tolist() == [0.0, 0.0, 0.0]
    assert abs(load.force(60.0)[0] - 0.2) < 1e-6


@pytest.mark.parametrize("edge", ["lowest", "highest"])
def test_every_load_is_finite_at_the_bounds_of_its_parameters(edge):
    low = edge == "lowest"
    frequency, time, damping = (1e-3, 0.01, 1e-3) if low else (100.0, 1e5, 0.999)
    loads = (
        HungWeightLoad(weight=20.0, frequency=frequency, lowering=time, damping=damping),
        SineLoad(amplitude=20.0, frequency=frequency),
        RaisedCosineLoad(peak=20.0, period=time),
    )
    for load in loads:
        for moment in (0.0, 0.005, 1.0, 86400.0):
            assert np.isfinite(load.force(moment)).all()


def test_all_around_load_keeps_its_magnitude_and_moves_from_pole_to_pole():
    around = load(kind="all_around", magnitude=0.3, period=60.0, turns=2.0, ramp=5.0)
    assert not around.force(-1.0).any()
    assert around.force(2.5) @ around.force(2.5) == pytest.approx(0.15**2)
    for time in (5.0, 17.0, 30.0, 59.0):
        assert np.linalg.norm(around.force(time)) == pytest.approx(0.3)
    np.testing.assert_allclose(around.force(15.0), 0.3 * np.array([-(0.5**0.5), 0.0, 0.5**0.5]), atol=1e-12)
    np.testing.assert_allclose(around.force(60.0), [0.0, 0.0, -0.3], atol=1e-12)


@pytest.mark.parametrize(
    "value", [0.5, np.zeros(2), np.zeros((3, 1)), np.array([np.nan, 0.0, 0.0]), None, "1", KeyError("peak")]
)
def test_custom_load_that_returns_no_force_is_refused_by_name(value: object) -> None:
    class Wrong(NoLoad):
        def force(self, time):
            if isinstance(value, Exception):
                raise value
            return value

    with pytest.raises(ContractError, match="load 'Wrong'"):
        force_of(Wrong(), 0.0)


def test_wall_moves_along_its_normal_as_configured():
    sine = WallLoad(distance=0.004, amplitude=0.005, frequency=0.25)
    beat = WallLoad(distance=0.004, motion="heartbeat", amplitude=0.005, frequency=1.0)
    assert [sine.displacement(time) for time in (-1.0, 0.0, 1.0, 2.0, 3.0)] == pytest.approx([0, 0, 5e-3, 0, -5e-3])
    # the beat takes 0.35 s of each second; its peak is in the middle
    assert [beat.displacement(time) for time in (0.0, 0.175, 0.35, 0.6, 3.175)] == pytest.approx([0, 5e-3, 0, 0, 5e-3])


def test_depth_in_a_wall_counts_from_its_present_surface():
    wall = WallLoad(direction=(0.0, 0.0, -2.0), distance=0.004, amplitude=0.005, frequency=0.25)
    assert wall.depth(np.array([1.0, 1.0, 0.006]), 0.0).depth == pytest.approx(0.002)
    assert wall.depth(np.array([1.0, 1.0, 0.006]), 1.0).depth == pytest.approx(0.007)
    assert wall.depth(np.zeros(3), 0.0).normal == pytest.approx([0.0, 0.0, -1.0])


def test_depth_in_a_sphere_is_its_radius_minus_the_distance_from_its_center():
    sphere = SphereLoad(center=(0.0, 0.003, 0.004), radius=0.01)
    assert sphere.depth(np.zeros(3), 0.0).depth == pytest.approx(0.005)
    assert sphere.depth(np.zeros(3), 0.0).normal == pytest.approx([0.0, -0.6, -0.8])
    assert np.isfinite(sphere.depth(np.array([0.0, 0.003, 0.004]), 0.0).normal).all()


@pytest.mark.parametrize("offset", [(0.004, 0.001, -0.002), (0.006, -0.003, 0.001), (0.003, 0.0, 0.0)])
def test_force_of_a_wall_with_a_lump_is_the_negative_gradient_of_its_energy(offset):
    wall = WallLoad(
        direction=(-2.0, 0.0, 0.0), distance=0.002, stiffness=150.0, lump_stiffness=250.0,
        lump_center=(9.0, 0.001, 0.0), lump_radius=0.004,
    )  # fmt: skip

    def energy(x: float, y: float, z: float) -> float:
        stiffness = 150.0 + 250.0 * math.exp(-((y - 0.001) ** 2 + z**2) / 0.004**2)
        return 0.5 * stiffness * (x - 0.002) ** 2

    def force(position: np.ndarray, step: float = 1e-6) -> list[float]:
        return [-(energy(*(position + d)) - energy(*(position - d))) / (2.0 * step) for d in step * np.eye(3)]

    assert elastic_force(wall, np.array(offset)) == pytest.approx(force(np.array(offset)), rel=1e-6, abs=1e-9)


def test_stiffness_of_a_lump_has_the_given_derivatives():
    wall = WallLoad(direction=(0.0, 0.6, -0.8), lump_stiffness=250.0, lump_center=(0.001, 0.0, 0.002))
    at, step = np.array([0.002, 0.001, 0.004]), 1e-6
    spots = [(wall.spot(at + d), wall.spot(at - d)) for d in step * np.eye(3)]
    here = wall.spot(at)

    assert here.gradient == pytest.approx([(a.stiffness - b.stiffness) / (2 * step) for a, b in spots], rel=1e-6)
    assert here.curvature == pytest.approx(
        np.array([(a.gradient - b.gradient) / (2 * step) for a, b in spots]), rel=1e-6
    )


def test_obstacle_that_the_tip_does_not_touch_has_no_elastic_force():
    assert not elastic_force(WallLoad(distance=0.005, lump_stiffness=10.0), np.array([0.0, 0.0, 0.0049])).any()
    assert not elastic_force(SphereLoad(center=(0.0, 0.0, 0.02), radius=0.01), np.zeros(3)).any()
