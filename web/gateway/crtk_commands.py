"""The station's side of CRTK: executes the commands of ROS 2 clients, and reports why one is refused.

The README has the table of commands. `enable` makes a client operator until the client has ended and its lease has
expired. Commands for the tip need a run for external targets, which this or another client has started as operator.
"""

import asyncio
import contextlib
import math
from collections import deque
from concurrent.futures import Executor

import numpy as np

from core.control.setpoint_request import SetpointRequest
from core.errors import CtrError
from core.robot.robot import Array
from station.control.commands import Command, Connect, Jog, Reset, Stop
from station.control.states import RefusedError, State
from station.control.task import ARRIVAL_TOLERANCE, JOG_TIMEOUT_S
from station.service.audit import Audit
from station.service.commands import Goto, Home, ServoJoints
from station.service.permits import Permit
from station.service.supervisor import Outcome, Supervisor
from web.access.identity import Role, Sender
from web.access.lease import Lease
from web.api.commands import commanding
from web.api.setpoints import until_over
from web.gateway.crtk import HOMED_STATES
from web.gateway.host import TargetStreams
from web.gateway.process import CrtkMessage, CrtkText

#: Interval at which the goal of a motion is repeated until the tip has arrived [s].
REPEAT_INTERVAL_S = 0.05
#: A motion ends when its setpoint and the tip are within these distances of its goal [m]. If the tip does not arrive,
#: for example at an obstacle, the motion ends this time after the setpoint has arrived [s].
SETPOINT_TOLERANCE_M, TIP_TOLERANCE_M, TIP_PATIENCE_S = 1e-4, 5e-4, 2.0
#: Time without a sign of life of a client after which its motion ends and another client may send targets [s].
ABSENT_AFTER_S = 3.0
#: Reports about one client: largest rate [1/s], and largest number at once. Largest number of texts to be sent.
MAX_REPORT_RATE_HZ, MAX_BURST, MAX_TEXTS = 1.0, 20.0, 50
#: Largest number of clients whose signs of life are kept.
MAX_CLIENTS = 100
#: Shortest interval between two streamed poses of the joints, whose check takes about 5 ms [s].
POSE_INTERVAL_S = 0.02


class CrtkCommands:
    """Commands of ROS 2 clients; all methods run in the event loop of the web server."""

    def __init__(
        self, supervisor: Supervisor, targets: TargetStreams, lease: Lease, audit: Audit, stopping: Executor
    ) -> None:
        """`stopping` has threads that are reserved for STOP."""
        self._supervisor, self._targets, self._lease = supervisor, targets, lease
        self._audit, self._stopping = audit, stopping
        self._now = supervisor.bench.clock.now
        self.texts = deque[CrtkText](maxlen=MAX_TEXTS)  #: texts for the clients
        self.changed = asyncio.Event()  #: set when `texts`, `busy` or `moves` have changed
        self.moves = 0  #: number of motions with an end that were started or refused
        self._repeating: asyncio.Task[None] | None = None  # repetition of the latest goal of the tip
        self._moving: asyncio.Task[None] | None = None  # this repetition until the tip has arrived
        self._goal: dict[int, tuple[float, ...]] = {}  # latest goal of the tip by the number of its run [m]
        self._executing: asyncio.Task[None] | None = None  # command that is being checked or executed
        self._ends = False  # whether that command is a motion with an end
        self._jog: tuple[CrtkMessage, Jog | ServoJoints, Permit] | None = None  # newest jog
        self._pose: tuple[float, tuple[float, ...]] = (-math.inf, ())  # time [s] and goal of the newest streamed pose
        self._jogging: asyncio.Task[None] | None = None
        self._stop_again: CrtkMessage | None = None  # newest stop
        self._stops: asyncio.Task[None] | None = None
        self._seen: dict[str, float] = {}  # time of each client's last sign of life [s]
        self._credit: dict[str, tuple[float, float]] = {}  # number of reports a client may cause, at a time [s]

    @property
    def busy(self) -> bool:
        """Whether a motion with an end (`move_*` or `home`) is being checked or has not ended yet."""
        return self._moving is not None or (self._ends and self._is_executing)

    @property
    def _is_executing(self) -> bool:
        return self._executing is not None and not self._executing.done()

    def receive(self, message: CrtkMessage) -> None:
        """Execute a command, or refuse it with a text on the topic `error`."""
        if message.client and (message.client in self._seen or len(self._seen) < MAX_CLIENTS):
            self._seen[message.client] = self._now()
        self._forget_absent()
        try:
            if message.stops:
                self._stop(message)
            elif message.name == "present":
                self._lease.renew(message.client)
            elif message.name == "state_command":
                self._state_command(message)
            elif message.name[-2] == "c":
                self._move_tip(message)
            else:
                self._move_joints(message)
        except CtrError as error:
            self._refuse(message, str(error))
        if message.ends:
            self.moves += 1
            self.changed.set()

    # Joints and states

    def _state_command(self, message: CrtkMessage) -> None:
        state = self._supervisor.status().state
        match message.text:
            case "enable":
                self._enable(message, state)
            case "resume":
                self._execute(message, Reset(who=self._name(message), of_fault=False))
            case "home":
                if state not in HOMED_STATES:
                    self._execute(message, Home(way_is_clear=True))
                elif self._is_reported(message.client):  # programs send it before they start, and expect no motion
                    self._tell("warning", "the stages are homed already; the page or REST can home them again")
            case "unhome":
                raise RefusedError("unhome is not available: the station keeps the positions of homed stages")
            case _:
                raise RefusedError("send enable, disable, pause, resume, home or unhome")

    def _enable(self, message: CrtkMessage, state: State) -> None:
        """Make the client operator, or let it send the targets of a run that another operator has started."""
        Reset(of_fault=False).check_fault(state)
        if state in (State.HOLD, State.STOPPED):
            raise RefusedError(f"the station is {state.name}; send resume")
        self._check_known(message)
        with contextlib.suppress(RefusedError):
            self._targets.current(message.client, message.received)
            return
        if not message.may_operate:
            raise RefusedError(
                "beyond loopback no client of ROS 2 becomes operator, because Zenoh has no passwords; an operator must"
                " start a run for external targets"
            )
        holder = self._lease.take(message.client, message.node)
        self._audit.write(self._name(message), "enable", "ROS 2", f"operator '{holder.name}'")
        if state is State.OFF:
            self._execute(message, Connect())
        elif state is State.CONNECTED:
            self._tell("warning", "the positions of the joints are unknown; send home")

    def _move_joints(self, message: CrtkMessage) -> None:
        self._check_operator(message)
        verb, space = message.name.split("_")
        values, (since, goal) = message.values, self._pose
        if space == "jr":
            continues = verb == "servo" and self._now() - since < JOG_TIMEOUT_S
            values = tuple(np.add(goal if continues else self._value("joints"), values).tolist())
        if verb == "move":
            names = self._supervisor.robot.joint_names
            self._execute(message, Goto(joints=dict(zip(names, values, strict=True))))
            return
        jogs = space == "jv"
        command = Jog(space="joints", velocity=values) if jogs else ServoJoints(joints=values)
        self._pose = (-math.inf, ()) if jogs else (self._now(), values)
        self._jog = message, command, self._supervisor.permit()
        if self._jogging is None or self._jogging.done():
            self._jogging = asyncio.create_task(self._send_jogs())

    async def _send_jogs(self) -> None:
        """Send the newest jog until there is none; jogs that arrive meanwhile replace each other."""
        while self._jog is not None:
            (message, command, permit), self._jog = self._jog, None
            sent = await self._send(message, command, permit)
            if sent is None:
                self._pose = -math.inf, ()  # the next step starts at the joints' measured positions
            if isinstance(command, Jog):
                continue
            await asyncio.sleep(POSE_INTERVAL_S)
            repeats = sent is not None and message.name == "interpolate_jp" and self._is_present(message.client)
            if self._jog is None and repeats and self._is_away(command.joints):
                self._jog = message, command, permit

    def _is_away(self, joints: tuple[float, ...]) -> bool:
        """Return whether the joints have not arrived at their positions `joints` [rad or m]."""
        left = np.abs(np.subtract(joints, self._value("joints")))
        return bool(np.any(left > ARRIVAL_TOLERANCE * self._supervisor.bench.robot.limits().speed))

    def _execute(self, message: CrtkMessage, command: Command) -> None:
        """Execute a command whose check may take seconds, in a thread."""
        if self._is_executing:
            raise RefusedError("the previous command has not ended yet; wait for its end, or send hold")
        self._ends = message.ends
        self._executing = asyncio.create_task(self._finish(message, command, self._supervisor.permit()))

    async def _finish(self, message: CrtkMessage, command: Command, permit: Permit) -> None:
        outcome = await self._send(message, command, permit)
        if outcome is not None:
            self._audit.write(self._name(message), message.text or message.name, "ROS 2", outcome.note or "done")
            if outcome.run is not None:
                await until_over(outcome.run)
        asyncio.get_running_loop().call_soon(self.changed.set)  # called when this task is done

    async def _send(self, message: CrtkMessage, command: Command, permit: Permit) -> Outcome | None:
        """Send a command of the operator to the station; None: it was refused."""
        who = Sender(Role.OPERATOR, message.client, message.node, "ROS 2")
        try:
            self._check_operator(message)
            async with commanding(self._lease, who, permit) as permitted:
                return await asyncio.to_thread(self._supervisor.send, command, permitted)
        except CtrError as error:
            self._refuse(message, str(error))
            return None

    # Tip

    def _move_tip(self, message: CrtkMessage) -> None:
        """Send a target or a velocity to the run for external targets."""
        verb, space = message.name.split("_")
        self._check_known(message)
        current = self._targets.current(message.client, message.received)
        if space == "cv":
            self._end_repetition()
            self._targets.send(current.stream.velocity(message.values, message.received))
            return
        goal = message.values
        if space == "cr":
            before = self._goal.get(current.run.number) or self._value("tip_desired").tolist()
            goal = tuple(np.add(before, goal).tolist())
        direction = message.direction if current.stream.controls_direction else None
        setpoint = current.stream.position(goal, message.received, message.sent, direction)
        self._end_repetition()
        self._goal = {current.run.number: goal}
        if verb == "servo":
            self._targets.send(setpoint)
            return
        at_rest = setpoint._replace(velocity=np.zeros(3))
        self._repeating = asyncio.create_task(self._repeat(message, goal, at_rest))
        self._moving = self._repeating if verb == "move" else None

    def _end_repetition(self) -> None:
        if self._repeating is not None:
            self._repeating.cancel()
        self._repeating = self._moving = None
        self._goal = {}

    async def _repeat(self, message: CrtkMessage, goal: tuple[float, ...], setpoint: SetpointRequest) -> None:
        """Repeat a goal until the next command while its client exists; a motion ends when the tip has arrived."""
        task, deadline = asyncio.current_task(), math.inf
        try:
            while self._is_present(message.client):
                now = self._now()
                self._targets.current(message.client, now)
                self._targets.send(setpoint._replace(time=now))
                if self._moving is task and math.dist(self._value("tip_desired"), goal) <= SETPOINT_TOLERANCE_M:
                    deadline, left = min(deadline, now + TIP_PATIENCE_S), math.dist(self._value("tip_observed"), goal)
                    if left <= TIP_TOLERANCE_M or now >= deadline:
                        self._end_move(task)
                    if left > TIP_TOLERANCE_M and now >= deadline:
                        self._tell("warning", f"{message.name}: the tip stays {1e3 * left:.2g} mm from its goal")
                await asyncio.sleep(REPEAT_INTERVAL_S)
        except RefusedError as error:
            if self._moving is task:
                self._refuse(message, f"the motion ended before the tip arrived: {error}")
        finally:
            self._end_move(task)

    def _end_move(self, task: object) -> None:
        if self._moving is task:
            self._moving = None
            self.changed.set()

    def _value(self, field: str) -> Array:
        """Return a field of the newest telemetry."""
        row = self._supervisor.ring.latest()
        if row is None:
            raise RefusedError("there is no telemetry before the stages are homed; send home")
        return self._supervisor.channels.of(row, field)

    # Stop, clients and texts

    def _stop(self, message: CrtkMessage) -> None:
        """Stop every axis, and end the lease by `disable`; stops that arrive meanwhile are merged into one more."""
        self._stop_again = message
        if self._stops is None or self._stops.done():
            self._stops = asyncio.create_task(self._send_stops())
        if message.text == "disable":
            self._lease.release(message.client)
            self._tell("warning", "disable has stopped the robot; the station has no command that removes power")

    async def _send_stops(self) -> None:
        while (message := self._stop_again) is not None:
            self._stop_again = None
            stop = Stop(cause=f"stopped by {self._name(message)}")
            outcome = await asyncio.get_running_loop().run_in_executor(self._stopping, self._supervisor.send, stop)
            if self._is_reported(message.client):
                self._audit.write(self._name(message), message.text or message.name, "ROS 2", outcome.note or "done")
            if outcome.note:
                self._tell("warning", outcome.note)

    def _name(self, message: CrtkMessage) -> str:
        return f"'{message.node}' (ROS 2)"

    def _check_known(self, message: CrtkMessage) -> None:
        if not message.client:
            raise RefusedError("the sender has no liveliness token of a ROS 2 publisher; only hold and pause need none")

    def _check_operator(self, message: CrtkMessage) -> None:
        self._check_known(message)
        if not self._lease.holds(message.client):
            raise RefusedError(f"'{message.node}' is not operator; send enable first")

    def _is_present(self, client: str) -> bool:
        return self._now() - self._seen.get(client, -math.inf) < ABSENT_AFTER_S

    def _forget_absent(self) -> None:
        now = self._now()
        for client in [client for client, seen in self._seen.items() if now - seen > ABSENT_AFTER_S]:
            del self._seen[client]
            self._credit.pop(client, None)
            self._targets.release(client)

    def _is_reported(self, client: str) -> bool:
        """Return whether to report an event of a client: a flood of its messages must not fill the log."""
        now = self._now()
        credit, counted = self._credit.get(client, (MAX_BURST, now))
        credit = min(MAX_BURST, credit + MAX_REPORT_RATE_HZ * (now - counted))
        self._credit[client] = max(0.0, credit - 1.0), now
        return credit >= 1.0

    def _refuse(self, message: CrtkMessage, reason: str) -> None:
        what = message.text or message.name
        if self._is_reported(message.client):
            self._audit.refused(self._name(message), what, "ROS 2", reason)
            self._tell("error", f"{what} of '{message.node}' is refused: {reason}")

    def _tell(self, topic: str, text: str) -> None:
        """Publish a text for the clients."""
        self.texts.append(CrtkText(topic, text))
        self.changed.set()
