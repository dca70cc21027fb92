"""The table of the station's states compared with a drawing, and the texts about the causes of a stop."""

import pytest

from station.control.states import RefusedError, State, StopReasons, Transition, next_state

#: Next state for each state (rows) and each event (columns); an event marked - is refused.
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


def test_drawing_of_the_state_table_has_every_state_and_every_event():
    assert set(CELLS) == {(state.name, event.value) for state in State for event in Transition}


@pytest.mark.parametrize(("state", "event"), [cell for cell in CELLS if cell not in REFUSED])
def test_event_leads_to_the_state_in_the_drawing_of_the_state_table(state, event):
    assert next_state(State[state], Transition(event)).name == CELLS[state, event]


@pytest.mark.parametrize(("state", "event"), REFUSED)
def test_event_without_a_transition_is_refused_with_the_states_that_allow_it(state, event):
    with pytest.raises(RefusedError) as refusal:
        next_state(State[state], Transition(event))

    text = str(refusal.value)
    assert text.startswith(f"'{event}' is not possible while {state}; it needs ")
    allowed = {origin for (origin, column), follows in CELLS.items() if column == event and follows != "-"}
    assert set(text.partition(" needs ")[2].split(" or ")) == allowed


def test_stop_is_accepted_in_every_state_and_ends_every_motion():
    assert all(next_state(state, Transition.STOP) is not State.RUNNING for state in State)


def test_fault_lasts_until_a_reset_after_which_devices_must_be_connected_again():
    accepted = {event for event in Transition if CELLS["FAULT", event.value] not in ("-", "FAULT")}

    assert accepted == {Transition.RESET}
    assert next_state(State.FAULT, Transition.RESET) is State.CONNECTING


def test_motion_may_start_only_in_ready():
    assert [state for state, event in CELLS if event == "start" and CELLS[state, event] != "-"] == ["READY"]


def test_later_cause_of_a_stop_is_added_once() -> None:
    causes = StopReasons().add("the line is cut").add("stopped by the operator").add("").add("stopped by the operator")

    assert str(causes) == "the line is cut; then stopped by the operator"


def test_longer_text_replaces_the_cause_that_it_starts_with() -> None:
    before = StopReasons().add("the tracker is silent", "port a").add("axis 1 is lost", "port b")
    causes = before.extend("axis 1 is lost; axis 2 is lost", "port b; port c")

    assert str(causes) == "the tracker is silent; then axis 1 is lost; axis 2 is lost"
    assert causes.details == "port a; then port b; port c"
    assert causes.extend("something else") == causes
