"""The whole state table, drawn here once more by hand."""

import pytest

from station.control.states import Event, RefusedError, State, after

#: What follows from each state (rows) at each event (columns); - is refused.
DRAWN = """
           connect    connected home   homed prepare start   finish hold stop      fault reset      reconnect
OFF        CONNECTING -         -      -     -       -       -      -    OFF       -     -          -
CONNECTING -          CONNECTED -      -     -       -       -      -    OFF       FAULT -          -
CONNECTED  -          -         HOMING HOMED -       -       -      -    CONNECTED FAULT -          -
HOMING     -          -         -      HOMED -       -       -      -    CONNECTED FAULT -          -
HOMED      -          -         -      -     READY   -       -      -    HOMED     FAULT -          -
READY      -          -         HOMING -     -       RUNNING -      HOLD STOPPED   FAULT -          -
RUNNING    -          -         -      -     -       -       READY  HOLD STOPPED   FAULT -          -
HOLD       -          -         -      -     -       -       -      -    STOPPED   FAULT READY      CONNECTING
STOPPED    -          -         -      -     -       -       -      -    STOPPED   FAULT READY      CONNECTING
FAULT      -          -         -      -     -       -       -      -    FAULT     FAULT CONNECTING -
"""

HEAD, *ROWS = (line.split() for line in DRAWN.strip().splitlines())
CELLS = {(row[0], event): follows for row in ROWS for event, follows in zip(HEAD, row[1:], strict=True)}
REFUSED = [cell for cell, follows in CELLS.items() if follows == "-"]


def test_the_drawing_has_every_state_and_every_event():
    assert set(CELLS) == {(state.name, event.value) for state in State for event in Event}


@pytest.mark.parametrize(("state", "event"), [cell for cell in CELLS if cell not in REFUSED])
def test_an_event_leads_where_the_drawing_says(state, event):
    assert after(State[state], Event(event)).name == CELLS[state, event]


@pytest.mark.parametrize(("state", "event"), REFUSED)
def test_any_other_event_is_refused_with_the_states_that_allow_it(state, event):
    with pytest.raises(RefusedError) as refusal:
        after(State[state], Event(event))

    said = str(refusal.value)
    assert said.startswith(f"'{event}' is not possible while {state}; it needs ")
    allowed = {origin for (origin, column), follows in CELLS.items() if column == event and follows != "-"}
    assert set(said.partition(" needs ")[2].split(" or ")) == allowed


def test_stop_is_accepted_everywhere_and_never_leaves_anything_running():
    assert all(after(state, Event.STOP) is not State.RUNNING for state in State)


def test_a_fault_stays_until_somebody_resets_it_and_then_devices_must_be_found_again():
    accepted = {event for event in Event if CELLS["FAULT", event.value] not in ("-", "FAULT")}

    assert accepted == {Event.RESET}
    assert after(State.FAULT, Event.RESET) is State.CONNECTING


def test_only_ready_may_start():
    assert [state for state, event in CELLS if event == "start" and CELLS[state, event] != "-"] == ["READY"]
