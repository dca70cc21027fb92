"""No command that is older than a STOP or a reset moves the robot, in whatever order requests arrive.

Hypothesis generates sequences of commands, STOPs, resets and disconnects for a complete station in virtual time, whose
answers do not depend on the computer's speed. `EXAMPLES=200 python -m pytest -n 0 -s` with this file tries more.
"""

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import Bundle, RuleBasedStateMachine, consumes, invariant, rule, run_state_machine_as_test

from core.errors import Unreachable
from station.config.motions import CircleMotion, HoldMotion
from station.control.commands import Command, CommandMessage, Execute, Jog, Reset, Tare
from station.control.states import RefusedError, State, Transition
from station.control.task import MotionTask
from station.experiments.experiment import Case
from station.service.commands import Goto, Home, Start, StreamAgreement, experiment_start
from station.service.permits import Permit, VoidError
from station.service.runs import StartRequest
from tests.harness.played_station import PlayedStation, played_station
from tests.harness.virtual_station import VirtualStation

EXAMPLES = int(os.environ.get("EXAMPLES", "5"))
MOVING = (State.RUNNING, State.HOMING)
#: Two positions of a joint for `goto`; the joint travels between them within a second [rad].
POSES = (0.0, 0.1)


@pytest.fixture(scope="module")
def played(case: Case) -> Iterator[PlayedStation]:
    with played_station(VirtualStation(case)) as station:
        yield station


def _calibrate(station: PlayedStation, permit: Permit) -> None:
    """Reserve the robot for a procedure and start its first step, as `CalibrationSession` does."""
    supervisor = station.supervisor
    supervisor.reserve("'calibrate' has reserved the robot", permit)
    try:
        start = experiment_start(supervisor, "demo")
        task = MotionTask(start.task.controller, start.task.orders, 0.5, start.task.start)
        supervisor.start_step(StartRequest(task, "calibrate", load=None, recorded=False), permit.lasting())
    finally:
        supervisor.release()


#: Commands to send; a calibration is a procedure and has no command.
COMMANDS: dict[str, Command | None] = {
    "hold": Start(trajectory=HoldMotion(), duration=1.0),
    "circle": Start(trajectory=CircleMotion(radius=0.003, period=10.0), duration=2.0),
    "experiment": Start(experiment="demo"),
    "goto": Goto(joints={"outer_rotation": POSES[1]}),
    "goto back": Goto(joints={"outer_rotation": POSES[0]}),
    "setpoints": StreamAgreement(duration=5.0),
    "calibrate": None,
    "home": Home(way_is_clear=True),
    "tare": Tare(),
    "jog": Jog(space="joints", velocity=(0.01, 0.0, 0.0)),
    "reset": Reset(who="'another page'"),
}


def _execute(kind: str, station: PlayedStation, permit: Permit) -> None:
    command = COMMANDS[kind]
    if command is None:
        _calibrate(station, permit)
    else:
        station.supervisor.send(command, permit)


#: Kinds of requests to draw from. Homing appears half as often, because it takes half a minute of virtual time.
KINDS = [kind for kind in sorted(COMMANDS) for _ in range(1 if kind == "home" else 2)]
#: Commands whose slow check is between the first and the last check of the state.
CHECKED = ("hold", "circle", "experiment", "goto", "goto back", "setpoints", "calibrate", "home")
BETWEEN: dict[str, Callable[[PlayedStation], Any]] = {
    "stop": lambda station: station.supervisor.stop(),
    "reset": lambda station: _tried(station.supervisor.reset),
    "time": lambda station: station.tick(20),
}


def _tried(action: Callable[[], Any]) -> RefusedError | Unreachable | None:
    """Execute the action; return its refusal, or None if it was accepted."""
    try:
        action()
    except (RefusedError, Unreachable) as error:
        return error
    return None


@dataclass
class Request:
    """A request that has arrived and has not been executed yet."""

    kind: str
    permit: Permit = field(repr=False)
    stops: int  #: number of STOPs before the request arrived
    orders: int  #: number of STOPs and resets before the request arrived
    gone: list[bool]
    between: list[Callable[[], Any]]  #: actions to execute after the first check has accepted the request
    late: bool = False  #: whether its deadline has passed


class AnyOrder(RuleBasedStateMachine):
    """State machine that sends requests in any order and checks that only valid commands move the robot."""

    station: PlayedStation
    examples = steps = accepted = void = 0
    waiting = Bundle("waiting")

    def __init__(self) -> None:
        super().__init__()
        type(self).examples += 1
        self.station.settle()
        self.stops = self.orders = 0
        self.may_move = False  # a valid command was accepted after the last STOP
        self.rested = self.station.virtual.places

    @rule(target=waiting, kind=st.sampled_from(KINDS))
    def arrive(self, kind: str) -> Request:
        gone, between = [False], list[Callable[[], Any]]()

        def hung_up() -> bool:
            # Every check of the permit calls this. The actions between the checks are executed at the first call.
            answer = gone[0]
            while between:
                between.pop(0)()
            return answer

        permit = self.station.supervisor.permit(hung_up)
        return Request(kind, permit, self.stops, self.orders, gone, between)

    @rule(request=waiting)
    def hang_up(self, request: Request) -> None:
        request.gone[0] = True

    @rule(request=consumes(waiting))
    def carry_out(self, request: Request) -> None:
        self._carry_out(request)

    @rule(request=consumes(waiting), between=st.lists(st.sampled_from(sorted(BETWEEN)), min_size=1, max_size=3))
    def carry_out_with_something_between_its_checks(self, request: Request, between: list[str]) -> None:
        if request.kind in CHECKED:
            request.between.extend(lambda one=one: self._do(one) for one in between)
        self._carry_out(request)

    @rule(kind=st.sampled_from(KINDS))
    def arrive_and_carry_out(self, kind: str) -> None:
        self._carry_out(self.arrive(kind))

    @rule()
    def recover(self) -> None:
        if self.station.state in (State.STOPPED, State.HOLD):
            self._do("reset")
            self.station.tick(20)

    @rule(what=st.sampled_from(["stop", "reset", "time"]))
    def do(self, what: str) -> None:
        self._do(what)

    @rule(ticks=st.integers(1, 300))
    def time_passes(self, ticks: int) -> None:
        self.station.tick(ticks)

    @rule(request=waiting)
    def deadline_passes(self, request: Request) -> None:
        request.permit, request.late = replace(request.permit, until=self.station.clock.now() - 1.0), True

    @rule()
    def device_fails(self) -> None:
        station = self.station
        if station.state in (State.READY, State.RUNNING):
            station.virtual.loop.stop(station.virtual.now, Transition.HOLD, "the tracker is silent")
            station.tick()

    @invariant()
    def nothing_moves_unless_a_valid_command_came_after_the_last_stop(self) -> None:
        type(self).steps += 1
        assert self.may_move or self.station.state not in MOVING

    def teardown(self) -> None:
        """Check that every waiting request is void after a last STOP and reset, and that nothing moves."""
        self._do("stop")
        self._do("reset")
        self.station.tick(200)
        places = self.station.virtual.places
        for request in self.names_to_values.values():
            if isinstance(request, Request):
                assert _tried(lambda one=request: _execute(one.kind, self.station, one.permit))
        self.station.tick(50)
        assert (self.station.virtual.places == places).all()

    def _do(self, what: str) -> None:
        if what != "time":
            self.orders += 1
        if what == "stop":
            self.stops += 1
            self.may_move = False
        BETWEEN[what](self.station)

    def _carry_out(self, request: Request) -> None:
        kind, state = request.kind, self.station.state
        refused = _tried(lambda: _execute(kind, self.station, request.permit))
        if kind == "reset":
            valid = request.stops == self.stops
            self.orders += 1
        else:
            valid = request.orders == self.orders and not request.gone[0] and not request.late
        if not valid:
            assert refused is not None, f"{request} was carried out"
            type(self).void += isinstance(refused, VoidError)
            return
        assert not isinstance(refused, VoidError), refused
        if refused is None:
            type(self).accepted += 1
            self.may_move = kind not in ("reset", "tare") or self.may_move
        else:
            # Earlier commands may have moved the robot to a pose from which the circle cannot be followed.
            assert state is not State.READY or kind == "reset" or isinstance(refused, Unreachable), refused


def test_command_older_than_a_stop_or_a_reset_never_moves_the_robot(played: PlayedStation) -> None:
    AnyOrder.station = played
    run_state_machine_as_test(
        AnyOrder,
        settings=settings(
            max_examples=EXAMPLES, stateful_step_count=25, deadline=None, derandomize=True, database=None,
            suppress_health_check=list(HealthCheck), phases=[Phase.generate, Phase.shrink],
        ),
    )  # fmt: skip
    print(f"\n{AnyOrder.examples} examples, {AnyOrder.steps} steps, {AnyOrder.accepted} accepted, {AnyOrder.void} void")  # noqa: T201


def test_refusal_of_a_void_command_names_the_stop_and_has_an_instruction(played: PlayedStation) -> None:
    played.settle()
    permit = played.supervisor.permit()
    played.supervisor.stop("stopped by a viewer, 'Anna'")
    played.supervisor.reset("'Berta'")
    with pytest.raises(VoidError) as refused:
        played.supervisor.send(Start(trajectory=HoldMotion()), permit)
    assert str(refused.value) == (
        "'start' is void: the station was stopped by a viewer, 'Anna' after this request arrived;"
        " check the robot, then send the request again"
    )


def test_control_process_refuses_a_command_sent_before_a_stop_and_read_after_it(played: PlayedStation) -> None:
    played.settle()
    task = experiment_start(played.supervisor, "demo").task
    permit = played.supervisor.permit()
    old = CommandMessage(1, Execute(task), generation=permit.generation)
    played.supervisor.stop()
    played.supervisor.reset()
    assert "before a STOP or a reset" in played._live._obey(old, played.virtual.now)
    assert played.state is State.READY
