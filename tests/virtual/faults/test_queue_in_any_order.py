"""The queue starts only its first waiting run, only while it is not paused and its operator has not changed.

Hypothesis generates sequences of requests to the queue, of operators, STOPs, resets, HOLDs and ends of the control
process, also during the check of a run and at the moment of its start, on a complete station in virtual time. The model
of the queue in this file decides at the moment in which a start is sent whether it is permitted.
`EXAMPLES=500 python -m pytest -n 0 -s` with this file tries more.
"""

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule, run_state_machine_as_test

from core.errors import CtrError
from station.config.motions import HoldMotion, Orders
from station.control.commands import CommandMessage, Execute
from station.control.states import RefusedError, State, Transition
from station.control.task import MotionTask
from station.experiments.experiment import Case
from station.service.commands import Start
from station.service.permits import Permit
from station.service.run_queue import EntryState, QueueEntry, RunQueue
from station.service.runs import RunRequest, StartRequest
from station.service.supervisor import Supervisor
from tests.harness.played_station import PlayedControl, PlayedStation, played_station
from tests.harness.virtual_station import VirtualStation
from web.access.lease import LEASE_S, Lease, LeaseHeldError

EXAMPLES = int(os.environ.get("EXAMPLES", "5"))
STEPS = int(os.environ.get("STEPS", "20"))
CLIENTS = ("anna", "ben")
#: Requests and events, which are methods of the machine; several appear twice, to occur more often.
REQUESTS = ("add", "add", "remove", "clear", "move", "pause", "resume", "resume", "release", "take over", "expiry")
EVENTS = ("stop", "reset", "hold", "end of the control process", "time")
#: Number of checks of the permit in one start, before the station sends the command. The last one is made while the
#: station sends, so a STOP cannot come between that check and the command.
CHECKS = 4

Action = tuple[str, int, str]
anything = st.tuples(st.sampled_from(REQUESTS + EVENTS), st.integers(0, 5), st.sampled_from(CLIENTS))
#: What comes before the check of a run, and at each check of its permit.
checks = st.lists(st.lists(anything, max_size=2), min_size=CHECKS, max_size=CHECKS)


@pytest.fixture
def played(case: Case) -> Iterator[PlayedStation]:
    with played_station(VirtualStation(case)) as station:
        yield station


@dataclass
class Counts:
    """Numbers of what the examples have tried."""

    examples: int = 0
    steps: int = 0
    started: int = 0
    voided: int = 0
    during_check: int = 0


class CheckedStart(Start):
    """Start of a run after a check that the test provides."""

    title: str
    check_motion: Callable[[str, Permit], RunRequest]

    def execute(self, station: Supervisor, permit: Permit) -> RunRequest:
        return self.check_motion(self.title, permit)


class QueueInAnyOrder(RuleBasedStateMachine):
    """State machine with a model of the queue: the waiting runs in their order, and whether they may start."""

    station: PlayedStation
    counts = Counts()

    def __init__(self) -> None:
        super().__init__()
        self.counts.examples += 1
        self.station.settle()
        self.station.reported()
        self.queue = RunQueue(self.station.supervisor)
        self.now = 0.0
        self.lease = Lease(lambda: self.now)
        self.order: list[str] = []  # titles of the waiting runs
        self.may_start = False
        self.checked = ""  # title of the run that is being checked
        self.sent: list[str] = []
        self.unwanted: list[str] = []
        self.numbers = 0
        self.during: list[list[Action]] = []
        robot = self.station.supervisor.bench.robot
        controller = self.station.supervisor.bench.controlled(self.station.supervisor.settings.controller)
        self.task = MotionTask(controller, Orders(HoldMotion(), robot.robot()), 0.1)
        PlayedControl.sent[:] = [self._on_command]
        for client in CLIENTS[:1] * 3:
            self._add(0, client)

    # Starts

    def _on_command(self, message: Any) -> None:
        if not (isinstance(message, CommandMessage) and isinstance(message.command, Execute)):
            return
        if not self.may_start or self.order[:1] != [self.checked]:
            self.unwanted.append(f"{self.checked} of {self.order}, may start: {self.may_start}")
        self.sent.append(self.checked)
        self.order = [title for title in self.order if title != self.checked]

    def _start(self, title: str, permit: Permit) -> RunRequest:
        """Start a run after a check during which the station executes other requests."""
        self.checked = title
        self._next_of_the_check()
        permit = permit.on(self._next_of_the_check)
        self.station.supervisor.check("start", Execute.states, permit)
        return self.station.supervisor.start(StartRequest(self.task, title, load=None, recorded=False), permit)

    def _next_of_the_check(self) -> str:
        if self.during:
            last = len(self.during) == 1
            for name, number, client in self.during.pop(0):
                if not last or name in REQUESTS:
                    self.counts.during_check += 1
                    self._do(name, number, client)
        return ""

    @rule(
        client=st.sampled_from(CLIENTS),
        during=st.lists(st.lists(anything, max_size=2), min_size=CHECKS, max_size=CHECKS),
    )
    def turn_with_requests_during_the_check(self, client: str, during: list[list[Action]]) -> None:
        self.recover(client)
        self.during = during
        self._turn()
        self.during = []

    @rule()
    def turn(self) -> None:
        self.station.reported()
        due = self.order[:1] if self.may_start and self.station.state is State.READY else []
        before = len(self.sent)
        self._turn()
        assert self.sent[before:] == due

    def _turn(self) -> None:
        self.station.reported()
        before, entries = len(self.sent), {entry.title: entry for entry in self.queue.entries}
        self.checked = ""
        self.queue.step()
        if self.checked:
            self.counts.started += len(self.sent) - before
            self.counts.voided += len(self.sent) == before
        for entry in self.queue.entries:
            if entry.state is EntryState.FAILED and entries.get(entry.title, entry).state is not EntryState.FAILED:
                self.may_start = False  # the run was refused, or has ended in HOLD
                self.order = [title for title in self.order if title != entry.title]

    # Requests and events

    @rule(action=anything)
    def act(self, action: Action) -> None:
        self._do(*action)

    @rule(client=st.sampled_from(CLIENTS))
    def recover(self, client: str) -> None:
        """Return the station to READY, let its run end, and resume the queue."""
        if self.station.supervisor.status().state in (State.STOPPED, State.HOLD, State.FAULT):
            self._do("reset", 0, CLIENTS[0])
            if self.station.state is not State.READY:
                self.station.settle()
        self._time(3, client)
        self._take_over(0, client)
        self._add(0, client)
        self._resume(0, client)

    def _do(self, name: str, number: int, client: str) -> None:
        getattr(self, f"_{name.replace(' ', '_')}")(number, client)

    def _permit(self, client: str) -> Permit | None:
        """Return the permit of a request of a client; None: another client is operator."""
        try:
            holder = self.lease.keep(client, client)
        except LeaseHeldError:
            return None
        return self.station.supervisor.permit().on(partial(self.lease.ended, holder))

    def _requested(self, client: str, request: Callable[[Permit], None]) -> bool:
        """Execute a request of a client; return whether the queue has accepted it."""
        permit = self._permit(client)
        if permit is None:
            return False
        try:
            request(permit)
        except RefusedError:
            return False
        return True

    def _add(self, number: int, client: str) -> None:
        self.numbers += 1
        title = f"run {self.numbers}"
        idle = not any(one.state in (EntryState.WAITING, EntryState.RUNNING) for one in self.queue.entries)
        if self._requested(
            client, partial(self.queue.add, [QueueEntry(title, CheckedStart(title=title, check_motion=self._start))])
        ):
            self.order.append(title)
            self.may_start = self.may_start or idle

    def _entry(self, number: int) -> QueueEntry | None:
        entries = self.queue.entries
        return entries[number % len(entries)] if entries else None

    def _remove(self, number: int, client: str) -> None:
        entry = self._entry(number)
        if entry is not None and self._requested(client, lambda _: self.queue.remove(entry.id)):
            self.order = [title for title in self.order if title != entry.title]

    def _clear(self, number: int, client: str) -> None:
        if self._requested(client, lambda _: self.queue.clear()):
            self.order = []

    def _move(self, number: int, client: str) -> None:
        entry, by = self._entry(number), (-2, -1, 1, 2)[number % 4]
        if entry is None or not self._requested(client, lambda _: self.queue.move(entry.id, by)):
            return
        position = self.order.index(entry.title) + by
        self.order.remove(entry.title)
        self.order.insert(max(0, position), entry.title)

    def _pause(self, number: int, client: str) -> None:
        if self._requested(client, lambda _: self.queue.pause("paused by the operator")):
            self.may_start = False

    def _resume(self, number: int, client: str) -> None:
        self.may_start = self._requested(client, self.queue.resume) or self.may_start

    def _release(self, number: int, client: str) -> None:
        self.may_start = self.may_start and not self.lease.holds(client)
        self.lease.release(client)

    def _take_over(self, number: int, client: str) -> None:
        self.may_start = self.may_start and self.lease.holds(client)
        self.lease.take(client, client, over=True)

    def _expiry(self, number: int, client: str) -> None:
        self.now += LEASE_S
        self.may_start = False

    def _stop(self, number: int, client: str) -> None:
        self.station.supervisor.stop()
        self.may_start = False

    def _reset(self, number: int, client: str) -> None:
        self.may_start = False
        try:
            self.station.supervisor.reset()
        except CtrError:
            return

    def _hold(self, number: int, client: str) -> None:
        station = self.station
        if station.state in (State.READY, State.RUNNING):
            station.virtual.loop.stop(station.virtual.now, Transition.HOLD, "the tracker is silent")
            station.tick()

    def _end_of_the_control_process(self, number: int, client: str) -> None:
        if PlayedControl.newest.alive:
            self.station.kill_control()

    def _time(self, number: int, client: str) -> None:
        if PlayedControl.newest.alive:
            self.station.tick((1, 10, 100)[number % 3])
            while number > 2 and self.station.state is State.RUNNING:
                self.station.tick(10)

    @invariant()
    def no_start_was_unwanted(self) -> None:
        self.counts.steps += 1
        assert self.unwanted == []

    @invariant()
    def waiting_runs_are_those_of_the_model_in_their_order(self) -> None:
        self.station.reported()
        waiting = [entry.title for entry in self.queue.entries if entry.state is EntryState.WAITING]
        assert waiting == self.order

    def teardown(self) -> None:
        PlayedControl.sent.clear()
        if not PlayedControl.newest.alive:
            self.station.supervisor.reset()


def test_queue_starts_only_its_first_permitted_run_while_it_is_not_paused(played: PlayedStation) -> None:
    QueueInAnyOrder.station = played
    run_state_machine_as_test(
        QueueInAnyOrder,
        settings=settings(
            max_examples=EXAMPLES, stateful_step_count=STEPS, deadline=None, derandomize=True, database=None,
            suppress_health_check=list(HealthCheck), phases=[Phase.generate, Phase.shrink],
        ),
    )  # fmt: skip
    print(f"\n{QueueInAnyOrder.counts}")  # noqa: T201
    assert QueueInAnyOrder.counts.started > 0
