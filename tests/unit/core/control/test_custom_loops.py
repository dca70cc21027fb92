"""A custom loop, task or limit has the computed effect, or the tick is refused with its name."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from core.control.controller_settings import Controller
from core.control.controllers import STRATEGIES, PositionMode, Strategy, TaskInputs, VelocityTask, strategy, type_2
from core.control.step import ControllerState, Sample, start_controller, step
from core.control.trajectories import Setpoint
from core.errors import ContractError, CtrError, DescriptionError, NotFinite
from core.robot.limits import Configuration, Limits, Workspace
from core.robot.robot import Array
from tests.unit.core.control.test_step import POSE, controller, plant_of

ORDER = Setpoint(np.array([1e-3, -2e-3, 3e-3]), np.array([2e-3, 0.0, 1e-3]))
GAINS = PositionMode(2.5, 2.5)
U_INT = np.array([1e-3, 2e-3, 3e-3])


@dataclass(frozen=True)
class Outer:
    """An outer loop that returns or raises one value."""

    value: Any

    def tip_velocity(self, setpoint: Setpoint, tip: Any) -> Any:
        if isinstance(self.value, BaseException):
            raise self.value
        return self.value


def inner_of(value: Any) -> Callable[..., Any]:
    def inner(u_int: Any, view: Any) -> Any:
        if isinstance(value, BaseException):
            raise value
        return value

    return inner


Bench = tuple[Controller, ControllerState, Sample]


@pytest.fixture(scope="module")
def bench(paper_robot) -> Bench:
    unit, plant = controller(paper_robot), plant_of(paper_robot)
    sample = plant.sample()
    return unit, start_controller(unit, sample), sample


def tick(bench: Bench, outer: Any, inner: Any, limits: Limits | None = None) -> Any:
    unit, memory, sample = bench
    custom = replace(unit, strategy=Strategy(outer, inner), limits=limits or unit.limits)
    return step(custom, memory, sample, ORDER)


ANY_ARRAY = arrays.arrays(
    dtype=st.one_of(
        arrays.floating_dtypes(), arrays.integer_dtypes(), arrays.complex_number_dtypes(), arrays.boolean_dtypes(),
        st.just(np.dtype(object)), st.just(np.dtype("U3")),
    ),
    shape=st.one_of(
        arrays.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=7), st.sampled_from([(3,), (3, 3)])
    ),
)  # fmt: skip
VELOCITIES = arrays.arrays(np.float64, 3, elements=st.floats())
JACOBIANS = arrays.arrays(np.float64, (3, 3), elements=st.floats())
ERRORS = st.sampled_from([KeyError("gain"), ZeroDivisionError(), ValueError("x"), SystemExit(1), CtrError("refused")])
ANYTHING = st.one_of(
    ANY_ARRAY, ERRORS, st.none(), st.floats(), st.integers(), st.text(max_size=3), st.lists(st.floats(), max_size=4),
    st.lists(st.lists(st.floats(), max_size=3), max_size=3), st.tuples(st.floats(), st.floats()),
)  # fmt: skip
THOROUGHLY = settings(
    max_examples=25, deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow, HealthCheck.data_too_large],
)  # fmt: skip


def usable(value: Any, shape: tuple[int, ...]) -> bool:
    """Return whether a value is an array of finite real numbers of a shape, by numpy alone."""
    try:
        array = np.asarray(value)
    except ValueError:
        return False
    if array.shape != shape or not np.issubdtype(array.dtype, np.number) or np.iscomplexobj(array):
        return False
    with np.errstate(over="ignore"):
        return bool(np.isfinite(array.astype(np.float64)).all())


def as_computed(found: Any, jacobian: Any, velocity: Any, bench: Bench) -> None:
    """Check that a command keeps its bounds and is optimal for the equation that the custom loop returned."""
    limits = bench[0].limits
    lower, upper = limits.velocity_bounds(bench[2].joints)
    assert np.isfinite(found.command).all()
    assert ((lower <= found.command) & (found.command <= upper)).all()
    jacobian, velocity = np.asarray(jacobian, dtype=np.float64), np.asarray(velocity, dtype=np.float64)
    with np.errstate(all="ignore"):
        left = np.linalg.norm(jacobian @ found.command - velocity)
    assert left <= np.linalg.norm(velocity) * (1.0 + 1e-6) + 1e-12


@THOROUGHLY
@example(value=0.01)
@example(value=np.zeros(2))
@example(value=np.zeros((3, 1)))
@example(value=np.array([np.nan, 0.0, 0.0]))
@given(value=st.one_of(ANYTHING, VELOCITIES))
def test_custom_outer_loop_moves_the_robot_as_computed_or_is_refused_by_name(bench: Bench, value: Any) -> None:
    try:
        found = tick(bench, Outer(value), type_2)
    except ContractError as error:
        assert "outer loop 'Outer'" in str(error)  # noqa: PT017 - or else the motion
        assert not usable(value, (3,))
    except NotFinite:
        assert np.abs(value).max() > 1e100  # the value is finite, but its square is infinite
    else:
        assert usable(value, (3,))
        assert np.array_equal(found.u_int, np.asarray(value, dtype=np.float64))


@THOROUGHLY
@example(sides=(np.ones((3, 3)), 0.01))
@example(sides=(np.ones((6, 3)), np.zeros(3)))
@example(sides=(np.ones((3, 3)), np.ones(2)))
@example(sides=(np.full((3, 3), 1e200), U_INT))
@example(sides=(np.full((3, 3), 1e-200), U_INT))
@given(sides=st.one_of(ANYTHING, st.tuples(st.one_of(ANYTHING, JACOBIANS), st.one_of(ANYTHING, VELOCITIES))))
def test_custom_inner_loop_moves_the_robot_as_computed_or_is_refused_by_name(bench: Bench, sides: Any) -> None:
    """A pair with an exception as one side is also an invalid value."""
    good = isinstance(sides, tuple) and len(sides) == 2 and usable(sides[0], (3, 3)) and usable(sides[1], (3,))
    try:
        found = tick(bench, GAINS, inner_of(sides))
    except ContractError as error:
        assert "inner loop 'inner'" in str(error)  # noqa: PT017 - or else the motion
        assert not good
    except NotFinite:
        assert good
        assert max(np.abs(side).max() for side in sides) > 1e100
    else:
        assert good
        as_computed(found, *sides, bench)


@pytest.mark.parametrize(
    ("outer", "inner", "words"),
    [
        (Outer(np.zeros(2)), type_2, r"outer loop 'Outer': U_int has shape \(2,\)"),
        (Outer(KeyError("gain")), type_2, "outer loop 'Outer' raised KeyError: 'gain'"),
        (GAINS, inner_of((np.ones((3, 3)), 0.01)), r"inner loop 'inner': the velocity has shape \(\) and type float64"),
    ],
)
def test_refusal_of_a_custom_loop_has_its_name_and_the_shape_or_the_exception(
    bench: Bench, outer: Any, inner: Any, words: str
) -> None:
    with pytest.raises(ContractError, match=words):
        tick(bench, outer, inner)


def test_transposed_jacobian_of_a_robot_with_more_joints_is_refused(three_tubes_controller) -> None:
    unit, joints = three_tubes_controller
    unit = replace(unit, strategy=Strategy(GAINS, lambda u, view: VelocityTask(view.loaded.jacobian[:3].T, u)))
    with pytest.raises(ContractError, match=r"the Jacobian has shape \(6, 3\)"):
        unit.check_loops(joints)


@pytest.fixture(scope="module")
def three_tubes_controller() -> tuple[Controller, np.ndarray]:
    from station.config.controllers import DEFAULT_CONTROLLER
    from station.config.robots import load_robot, named_pose

    robot = load_robot("three_tubes")
    assert robot.working_pose is not None
    return DEFAULT_CONTROLLER.controller(robot), named_pose(robot.working_pose, robot, "working_pose")


def test_custom_loops_are_refused_before_anything_moves(bench: Bench) -> None:
    unit = bench[0]
    for wrong in (Strategy(Outer(0.01), type_2), Strategy(GAINS, lambda u, view: (view.loaded.jacobian, u))):
        with pytest.raises(ContractError, match="has shape"):
            replace(unit, strategy=wrong).check_loops(POSE)
    replace(unit, strategy=Strategy(Outer(U_INT), type_2)).check_loops(POSE)


def test_subclass_of_a_built_in_loop_is_not_replaced_by_the_compiled_loop(bench: Bench) -> None:
    class Still(PositionMode):
        def tip_velocity(self, setpoint: Setpoint, tip: Any) -> Any:
            return np.zeros(3)

    assert not tick(bench, Still(2.5, 2.5), type_2).u_int.any()


def test_custom_loop_that_overwrites_its_arguments_changes_nothing_else(bench: Bench) -> None:
    def spoil(u_int: Any, view: Any) -> VelocityTask:
        task = type_2(u_int, view)
        for part in (
            u_int,
            view.loaded.numbers,
            view.unloaded.numbers,
            view.load_rate,
            view.deflection_rate,
            view.drift,
        ):
            part[:] = np.nan
        return task

    class Spoiling(PositionMode):
        def tip_velocity(self, setpoint: Setpoint, tip: Any) -> Any:
            u_int = super().tip_velocity(setpoint, tip)
            for part in (setpoint.position, setpoint.velocity, tip):
                part[:] = np.nan
            return u_int

    spoiled, expected = tick(bench, Spoiling(2.5, 2.5), spoil), tick(bench, GAINS, lambda u, view: type_2(u, view))
    assert np.array_equal(spoiled.command, expected.command)
    assert np.array_equal(spoiled.memory.estimate.numbers, expected.memory.estimate.numbers)
    assert np.isfinite([ORDER.position, ORDER.velocity]).all()


def test_custom_strategy_that_returns_no_strategy_is_refused_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(STRATEGIES, "mine", lambda gains, inner: (gains, inner))  # type: ignore[arg-type, return-value]
    with pytest.raises(ContractError, match="strategy 'mine' returned a tuple"):
        strategy("mine")


@dataclass(frozen=True)
class Custom:
    """A limit that returns one value."""

    value: Any
    names: tuple[str, ...] = ("custom",)

    def rows(self, at: Configuration) -> Any:
        if isinstance(self.value, BaseException):
            raise self.value
        return self.value

    def check(self, at: Configuration) -> None:
        """Accept every configuration."""


ROWS = arrays.arrays(np.float64, (1, 3), elements=st.floats())
ROOM = arrays.arrays(np.float64, 1, elements=st.floats())


@THOROUGHLY
@example(value=(np.zeros((1, 3)), np.array([np.nan])))
@example(value=(np.ones((1, 3)), np.zeros(2)))
@example(value=(np.ones(3), np.zeros(1)))
@given(value=st.one_of(ANYTHING, st.tuples(st.one_of(ANYTHING, ROWS), st.one_of(ANYTHING, ROOM))))
def test_custom_limit_is_obeyed_or_refused_by_name(bench: Bench, value: Any) -> None:
    good = isinstance(value, tuple) and len(value) == 2 and usable(value[0], (1, 3)) and usable(value[1], (1,))
    good = good and np.asarray(value[1])[0] >= 0.0
    if good:
        assume(np.abs(value[0]).max() < 1e100)
    limits = replace(bench[0].limits, others=(Custom(value),))
    try:
        found = tick(bench, GAINS, type_2, limits)
    except ContractError as error:
        assert "limit 'Custom'" in str(error)  # noqa: PT017 - or else the motion
        assert not good
    else:
        assert good
        rows, room = (np.asarray(part, dtype=np.float64) for part in value)
        assert (rows @ found.command <= room + 1e-9 * (1.0 + np.abs(rows).max() + room.max())).all()


def test_custom_limit_is_refused_before_anything_moves(bench: Bench) -> None:
    at = Configuration(POSE, np.zeros((3, 3)), np.zeros(3), np.zeros(3))
    with pytest.raises(ContractError, match=r"limit 'Custom': room has shape \(2,\)"):
        replace(
            bench[0].limits, others=(Workspace((-1.0,) * 3, (1.0,) * 3), Custom((np.ones((1, 3)), np.zeros(2))))
        ).check_all(at)


@dataclass(frozen=True)
class CustomTask:
    """A task that returns or raises one value."""

    value: Any

    def rows(self, at: TaskInputs) -> Any:
        at.loaded.jacobian[:] = np.nan  # the task receives copies, so this has no effect
        if isinstance(self.value, BaseException):
            raise self.value
        return self.value


def tick_with(bench: Bench, *tasks: Any) -> Array:
    """Return the joint velocities (n,) of a tick with these tasks in addition to the tip's position."""
    unit, memory, sample = bench
    return step(replace(unit, tasks=tasks), memory, sample, ORDER).command


@THOROUGHLY
@example(value=(np.zeros((1, 3)), np.array([np.nan])))
@example(value=(np.ones((1, 3)), np.zeros(2)))
@example(value=(np.ones(3), np.zeros(1)))
@given(value=st.one_of(ANYTHING, st.tuples(st.one_of(ANYTHING, ROWS), st.one_of(ANYTHING, ROOM))))
def test_custom_task_is_carried_out_inside_the_limits_or_refused_by_name(bench: Bench, value: Any) -> None:
    good = isinstance(value, tuple) and len(value) == 2 and usable(value[0], (1, 3)) and usable(value[1], (1,))
    if good:
        assume(max(np.abs(value[0]).max(), np.abs(value[1]).max()) < 1e50)
    try:
        velocity = tick_with(bench, CustomTask(value))
    except ContractError as error:
        assert "task 'CustomTask'" in str(error)  # noqa: PT017 - or else the motion
        assert not good
    else:
        assert good
        assert (np.abs(velocity) <= bench[0].limits.speed * (1.0 + 1e-9)).all()


def test_heavy_row_of_a_custom_task_outweighs_the_position_and_a_zero_row_changes_nothing(bench: Bench) -> None:
    zero = CustomTask(VelocityTask(np.zeros((1, 3)), np.zeros(1)))
    np.testing.assert_allclose(tick_with(bench, zero), tick_with(bench), rtol=1e-9, atol=1e-12)
    # The row requests 0.01 rad/s of the first joint with a weight far above that of the position.
    heavy = CustomTask(VelocityTask(np.array([[1e3, 0.0, 0.0]]), np.array([10.0])))
    assert tick_with(bench, heavy)[0] == pytest.approx(0.01, rel=1e-3)


def test_custom_task_is_called_before_anything_moves_and_needs_built_in_loops(bench: Bench) -> None:
    unit, _, sample = bench
    with pytest.raises(ContractError, match="task 'CustomTask' raised ValueError: no"):
        replace(unit, tasks=(CustomTask(ValueError("no")),)).check_loops(sample.joints)
    with pytest.raises(DescriptionError, match="built-in strategy with further tasks"):
        replace(unit, strategy=Strategy(Outer(U_INT), type_2), tasks=(CustomTask(None),))
