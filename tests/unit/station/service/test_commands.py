"""The table of commands: the Python client sends each of them, and their states are those of the state machine."""

import inspect
import json
from typing import Any

import httpx
import pytest

from station.client import Station
from station.control.commands import Command, Stop
from station.control.states import TRANSITIONS, State, Transition
from station.service.commands import COMMANDS

#: Calls of the Python client, whose requests are those of all commands.
CALLS: dict[str, tuple[Any, ...]] = {
    "connect": (), "home": (), "tare": (), "start": ("fig10",), "goto": (), "jog": ("tip", (0.0, 0.0, 0.002)),
    "set_stiffness": ((30.0, 30.0, 300.0),), "mark": ("touched the tip",), "stop": (), "reset": (),
    "apply_load": ({"kind": "constant", "magnitude": 0.2},), "inject_faults": ({"kind": "mute", "device": "tracker"},),
}  # fmt: skip
READY = {"state": "READY", "format": 1, "run": {"id": "r", "recording": False}, "run_id": "r", "note": ""}


def requests_of(method: str, arguments: tuple[Any, ...]) -> list[tuple[str, str, Any]]:
    """Return method, path and body of the changing requests of a call of the client."""
    sent = list[tuple[str, str, Any]]()

    def answer(request: httpx.Request) -> httpx.Response:
        if request.method != "GET":
            sent.append((request.method, request.url.path, json.loads(request.content or b"{}")))
        return httpx.Response(200, json=READY)

    client = Station()
    client._http.close()
    client._http = httpx.Client(base_url="http://station", transport=httpx.MockTransport(answer))
    getattr(client, method)(*arguments)
    client._http.close()
    return sent


def test_python_client_sends_every_command_with_its_fields() -> None:
    sent = [request for name, arguments in CALLS.items() for request in requests_of(name, arguments)]
    sent += requests_of("inject_faults", ())
    commands = {(command.method, command.path()): command for command in COMMANDS}
    assert {(method, path) for method, path, _ in sent} == set(commands)
    for method, path, body in sent:
        commands[method, path].model_validate(body, strict=False)


def test_stop_is_accepted_in_every_state_and_with_any_cause() -> None:
    assert set(Stop.states) == set(State)
    assert Stop(cause="half of a pair: \ud800").cause.endswith("\ud800")


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.__name__)
def test_command_has_one_sentence_and_only_states_of_its_events(command: type[Command]) -> None:
    text = inspect.cleandoc(command.__doc__ or "").split("\n\n")[0]
    assert text.endswith(".")
    assert len(set(command.states)) == len(command.states) > 0
    if command.name in list(Transition):
        assert set(command.states) == {state for state, event in TRANSITIONS if event == command.name}
    # Nothing that moves the robot is accepted before its positions are known, or in a state that a person must reset.
    allowed = {State.CONNECTED, State.READY, State.RUNNING}
    assert not command.moves or set(command.states) <= allowed
    assert not command.starts_run or command.moves
