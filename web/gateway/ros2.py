"""ROS 2 over Zenoh, without an installation of ROS 2: the topics of `crtk.py`, as `rmw_zenoh_cpp` sends and finds them.

A sender is known by the GID in the attachment of its messages. The GID is the hash of the publisher's liveliness token,
which also names the session and the node. All publishers of one Zenoh session are one client. Only the newest messages
of each sender and command wait for the gateway. So a flood neither uses memory nor displaces the commands of other
clients.
"""

import asyncio
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import count
from typing import Any, NamedTuple

import xxhash
import zenoh
from zenoh.ext import AdvancedPublisher, CacheConfig, declare_advanced_publisher

from station.config.robots import RobotFile
from station.control.states import RefusedError
from station.control.telemetry import Channels
from web.access.gate import is_loopback
from web.gateway.cdr import MAX_MESSAGE_BYTES, BadMessage
from web.gateway.crtk import INPUTS, OUTPUTS, Input, Sample, message, operating_state
from web.gateway.crtk_services import Service, services
from web.gateway.options import GatewayError, ListenAddress
from web.gateway.process import CrtkMessage, CrtkText
from web.gateway.ros_types import STATE, STRING, RosType
from web.gateway.snapshot import Snapshot, StationInfo

#: ROS_DOMAIN_ID that other nodes must use, and the ROS 2 node name of the gateway.
ROS_DOMAIN, NODE_NAME = 0, "ctr_station"
#: Quality of service as `rmw_zenoh_cpp` encodes it: the defaults of ROS 2 with a history of ten messages; then the same
#: for latched topics, with the durability "transient local" and a history of one message.
_QOS, _LATCHED_QOS = "::,10:,:,:,,", ":1:,1:,:,:,,"
#: Shortest interval between two readings of the received commands, against floods [s].
READ_INTERVAL_S = 0.002
#: Largest number of waiting messages of one sender and command: the newest only, but more if each message is a step.
MAX_WAITING, MAX_WAITING_STEPS = 1, 8
#: Interval at which the gateway reports which clients exist, and repeats the operating state [s].
PRESENCE_INTERVAL_S = 1.0
#: Largest number of publishers whose tokens are known; further ones cannot send commands.
MAX_PUBLISHERS = 500
#: Largest number of requests of services that wait; further ones are not answered.
MAX_REQUESTS = 10
#: Bytes that precede the number, the time and the GID of the sender in the attachment of a message.
_ATTACHMENT = (b"\x0fsequence_number", b"\x10source_timestamp", b"\x0asource_gid\x10")
_ATTACHMENT_BYTES = sum(map(len, _ATTACHMENT)) + 8 + 8 + 16

#: Handler that Zenoh calls in the thread of a client's connection: it receives the token before the first command.
_in_order = partial(zenoh.handlers.Callback, indirect=False)


class Client(NamedTuple):
    """Zenoh session that publishes a command."""

    session: str  #: id of the Zenoh session, by which the client is known
    node: str  #: name of the ROS 2 node


UNKNOWN = Client("", "unknown")  #: a sender without a liveliness token


class _Received(NamedTuple):
    """A message that waits for its check."""

    data: bytes
    client: Client
    sent: float | None  #: time by the sender's clock [s]


class _Publisher(NamedTuple):
    """The publisher of one topic; receivers count the messages of each GID separately."""

    zenoh: Any  #: `zenoh.Publisher`, or for latched messages an `AdvancedPublisher`
    gid: bytes
    numbers: "count[int]"

    @property
    def matching(self) -> bool:
        """Whether to publish: a subscriber exists, or the message is latched for later subscribers."""
        # Typed as Any because the type stubs of `zenoh` wrongly declare `matching_status` as a bool.
        return isinstance(self.zenoh, AdvancedPublisher) or self.zenoh.matching_status.matching

    def put(self, data: bytes) -> None:
        """Publish a message with the attachment that `rmw_zenoh_cpp` requires: number, time and sender."""
        self.zenoh.put(data, attachment=_attachment(next(self.numbers), self.gid))


class Ros2Outlet:
    """Node of ROS 2 that publishes the robot's state and receives commands under CRTK's names."""

    def __init__(
        self,
        file: RobotFile,
        channels: Channels,
        namespace: str,
        send: Callable[[CrtkMessage], bool],
        now: Callable[[], float],
        log: Callable[[str], None],
    ) -> None:
        """Prepare the topics of a robot below `namespace`; `now` returns the station's time [s].

        `send` passes a command to the station process and returns False if it cannot take it now. `log` writes a text
        to the station's log.
        """
        self._robot, self._channels, self._namespace = file.robot(), channels, namespace
        self._send, self._now, self._log = send, now, log
        self.refused = Counter[str]()  #: number of refused messages of each command
        self._session: zenoh.Session | None = None
        self._publishers: dict[str, _Publisher] = {}
        self._waiting: dict[tuple[str, bytes], deque[_Received]] = {}  # by command and GID of the sender
        self._lock = threading.Lock()  # for `_waiting`
        self._arrived, self._loop = asyncio.Event(), asyncio.get_running_loop()
        self._clients: dict[bytes, Client] = {}  # by the GIDs of their publishers of commands
        self._declared: list[Any] = []  # tokens, and the subscriber of tokens; they end when they are deleted
        self._may_operate = False
        self._info = StationInfo()
        self._shown: tuple[StationInfo, bool] | None = None
        self._moves = 0  # number of motions with an end that were sent to the station process
        self._due = 0.0
        self._reading: asyncio.Task[None] | None = None
        self._services = services(file, lambda: operating_state(self._info, self._is_busy(self._info), time.time_ns()))
        # Zenoh's threads must not wait for an answer, because they also receive `hold`.
        self._answering, self._free = ThreadPoolExecutor(1), threading.BoundedSemaphore(MAX_REQUESTS)

    def open(self, address: ListenAddress) -> str:
        """Listen at the address, or join the Zenoh router that listens there; return the result as text.

        Raises:
            GatewayError: neither listening nor joining is possible.
        """
        zenoh.init_log_from_env_or("off")
        session, joined = _session("listen", address), False
        if session is None:
            session, joined = _session("connect", address), True
        if session is None:
            raise GatewayError(f"--ros2 {address} is not available: the port is in use, and not by a Zenoh router")
        self._session = session
        # A router may be open to other computers, and Zenoh has no passwords.
        self._may_operate = is_loopback(address.host) and not joined
        about = f"@ros2_lv/{ROS_DOMAIN}/{session.info.zid()}/0"
        live, numbers = session.liveliness(), count(1)
        self._declared.append(live.declare_token(f"{about}/0/NN/%/%/{NODE_NAME}"))

        def declare(role: str, name: str, kind: RosType, latched: bool) -> tuple[str, str]:
            topic = name if name.startswith("/") else f"/{self._namespace}/{name}"
            what = f"{topic.replace('/', '%')}/{kind.wire}/{kind.hash}/{_LATCHED_QOS if latched else _QOS}"
            token = f"{about}/{next(numbers)}/{role}/%/%/{NODE_NAME}/{what}"
            self._declared.append(live.declare_token(token))
            return token, zenoh_key(topic, kind)

        for name, output in OUTPUTS.items():
            token, key = declare("MP", name, output.kind, output.latched)
            drop = zenoh.CongestionControl.DROP
            publisher: Any = (
                declare_advanced_publisher(
                    session, key, congestion_control=drop, cache=CacheConfig(1), publisher_detection=True
                )
                if output.latched
                else session.declare_publisher(key, congestion_control=drop)
            )
            self._publishers[name] = _Publisher(publisher, gid_of(token), count(1))
        tokens = f"@ros2_lv/{ROS_DOMAIN}/*/*/*/MP/*/*/*/%{self._namespace}%$*/*/*/*"
        self._declared.append(live.declare_subscriber(tokens, _in_order(self._take_token), history=True))
        for name, each in INPUTS.items():
            # Latched commands of earlier times are not requested: an old "home" must not move the robot.
            _, key = declare("MS", name, each.kind, each.latched)
            self._declared.append(session.declare_subscriber(key, _in_order(partial(self._receive, name))))
        for name, service in self._services.items():
            _, key = declare("SS", name, service.kind.kind, latched=False)
            self._declared.append(session.declare_queryable(key, partial(self._request, key, service), complete=True))
        self._reading = asyncio.create_task(self._read())
        return f"with the Zenoh router at {address}" if joined else f"at tcp/{address} (Zenoh)"

    @property
    def needs_scene(self) -> bool:
        """Whether the robot's shape is needed, because a ROS 2 subscriber exists."""
        return any(self._publishers[name].matching for name, output in OUTPUTS.items() if output.value)

    def publish(self, snapshot: Snapshot) -> None:
        """Publish a snapshot of the robot; slow subscribers miss messages."""
        self._publish_state(snapshot.info)
        if snapshot.scene is None:
            return
        sample = Sample(self._robot, self._channels, snapshot.scene)
        for name, output in OUTPUTS.items():
            if output.value and self._publishers[name].matching:
                self._publishers[name].put(message(output, sample))

    def report(self, text: CrtkText) -> None:
        """Publish a text of the station process on its topic."""
        self._publishers[text.topic].put(STRING.encode(text.text))

    async def close(self) -> None:
        """End the Zenoh session."""
        if self._reading is not None:
            self._reading.cancel()
        self._answering.shutdown(cancel_futures=True)
        if self._session is not None:
            self._session.close()

    def _publish_state(self, info: StationInfo) -> None:
        """Publish the operating state at each change and once a second."""
        busy = self._is_busy(info)
        now = time.monotonic()
        if self._shown != (info, busy) or now >= self._due:
            self._due = now + PRESENCE_INTERVAL_S
            self._publishers["operating_state"].put(STATE.encode(*operating_state(info, busy, time.time_ns())))
            for client in set(self._clients.copy().values()):
                self._send(CrtkMessage("present", *client, self._may_operate, self._now()))
        if info.state is not self._info.state or info.cause != self._info.cause:
            self.report(CrtkText("status", info.text))
            if info.cause:
                self.report(CrtkText("error", info.text))
        self._shown, self._info = (info, busy), info

    def _is_busy(self, info: StationInfo) -> bool:
        # The robot is busy as soon as a motion arrives here, so that a client that waits for the end sees the start.
        return info.busy or self._moves > info.moves

    def _request(self, key: str, service: Service, query: zenoh.Query) -> None:
        """Answer the request of a service later; Zenoh calls this in a thread of the sender's connection."""
        if self._free.acquire(blocking=False):
            self._answering.submit(self._answer, key, service, query)

    def _answer(self, key: str, service: Service, query: zenoh.Query) -> None:
        try:
            payload, attachment = query.payload, query.attachment
            request = service.kind.request.decode(b"" if payload is None else payload.to_bytes())
            response = service.kind.response.encode(*service.answer(request))
            number, _, gid = attached(b"" if attachment is None else attachment.to_bytes())
            query.reply(key, response, attachment=_attachment(number, gid))
        except BadMessage as error:
            query.reply_err(str(error))
        finally:
            query.drop()
            self._free.release()

    def _receive(self, name: str, sample: zenoh.Sample) -> None:
        """Keep a received message until its check; Zenoh calls this in the thread of the sender's connection."""
        _, sent, gid = attached(b"" if sample.attachment is None else sample.attachment.to_bytes())
        client = self._clients.get(gid)
        # A longer message is refused when it is decoded.
        data = sample.payload.to_bytes() if len(sample.payload) <= MAX_MESSAGE_BYTES else bytes(MAX_MESSAGE_BYTES + 1)
        with self._lock:
            if not self._waiting:
                self._loop.call_soon_threadsafe(self._arrived.set)
            most = MAX_WAITING_STEPS if name.endswith("r") or name == "state_command" else MAX_WAITING
            waiting = self._waiting.setdefault((name, gid if client else b""), deque(maxlen=most))
            waiting.append(_Received(data, client or UNKNOWN, sent))

    async def _read(self) -> None:
        while True:
            await self._arrived.wait()
            self._arrived.clear()
            with self._lock:
                arrived, self._waiting = self._waiting, {}
            for (name, _), waiting in sorted(arrived.items(), key=lambda item: item[0][0] != "hold"):
                for received in waiting:
                    await self._take(name, INPUTS[name], received)
            await asyncio.sleep(READ_INTERVAL_S)

    async def _take(self, name: str, each: Input, received: _Received) -> None:
        """Check and send a command, or refuse it with the reason; a stop waits until the station can take it."""
        client = received.client
        try:
            content = each.parse(self._robot, each.kind.decode(received.data))
            command = CrtkMessage(name, *client, self._may_operate, self._now(), received.sent, *content)
            while not self._send(command):
                if not command.stops:
                    raise RefusedError("the station is busy; send it again")
                await asyncio.sleep(READ_INTERVAL_S)
        except (BadMessage, RefusedError) as error:
            self.refused[name] += 1
            if str(self.refused[name]).rstrip("0") == "1":  # the 1st, 10th, 100th ...
                text = f"{name} of '{client.node}' is refused ({self.refused[name]} so far): {error}"
                self._log(f"ROS 2: {text}")
                self.report(CrtkText("error", text))
            return
        if command.ends:
            self._moves += 1
            self._publish_state(self._info)

    def _take_token(self, sample: zenoh.Sample) -> None:
        """Add or remove the client of a publisher of commands; called in the thread of the client's connection."""
        parts = (token := str(sample.key_expr)).split("/")
        if sample.kind == zenoh.SampleKind.DELETE:
            self._clients.pop(gid_of(token), None)
        elif parts[9].removeprefix(f"%{self._namespace}%") in INPUTS and len(self._clients) < MAX_PUBLISHERS:
            self._clients[gid_of(token)] = Client(parts[2], parts[8][:40])


def attached(data: bytes) -> tuple[int, float | None, bytes]:
    """Return number, time by the sender's clock [s] and GID of an attachment; 0, None and no bytes if it has none."""
    first, second, third = _ATTACHMENT
    if len(data) != _ATTACHMENT_BYTES or not data.startswith(first):
        return 0, None, b""
    rest = data[len(first) + 8 :]
    if not rest.startswith(second) or not rest[len(second) + 8 :].startswith(third):
        return 0, None, b""
    number, sent = (
        int.from_bytes(part[:8], "little", signed=True) for part in (data[len(first) :], rest[len(second) :])
    )
    return number, 1e-9 * sent, data[-16:]


def _attachment(number: int, gid: bytes) -> bytes:
    """Return the attachment that `rmw_zenoh_cpp` requires: number, present time and GID of the sender."""
    numbers = (each.to_bytes(8, "little", signed=True) for each in (number, time.time_ns()))
    return b"".join(name + value for name, value in zip(_ATTACHMENT, (*numbers, gid), strict=True))


def gid_of(token: str) -> bytes:
    """Return the GID of the publisher with a liveliness token, as `rmw_zenoh_cpp` computes it: XXH3 with 128 bits."""
    return xxhash.xxh3_128_intdigest(token.encode()).to_bytes(16, "little")


def zenoh_key(topic: str, kind: RosType) -> str:
    """Return the Zenoh key under which `rmw_zenoh_cpp` expects a topic."""
    return f"{ROS_DOMAIN}{topic}/{kind.wire}/{kind.hash}"


def _session(mode: str, address: ListenAddress) -> zenoh.Session | None:
    """Return a Zenoh session that uses only this address, with `mode` 'listen' or 'connect'; None if it fails."""
    config = zenoh.Config()
    # Zenoh's shared memory would leave a file in /dev/shm after a kill, and has no benefit for messages this small.
    for key in ("scouting/multicast/enabled", "transport/shared_memory/enabled"):
        config.insert_json5(key, "false")
    # Latched messages need time stamps.
    for key in ("timestamping/enabled", "connect/exit_on_failure", "listen/exit_on_failure"):
        config.insert_json5(key, "true")
    for key in ("listen", "connect"):
        config.insert_json5(f"{key}/endpoints", f'["tcp/{address}"]' if mode == key else "[]")
    config.insert_json5("mode", '"peer"')
    config.insert_json5("connect/timeout_ms", "5000")
    try:
        return zenoh.open(config)
    except zenoh.ZError:
        return None
