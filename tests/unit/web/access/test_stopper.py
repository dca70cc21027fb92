"""The cause of a STOP names who pressed it, with the address."""

import pytest

from web.access.identity import Role, Sender
from web.access.lease import Lease
from web.api.commands import stopper

ANNA = Sender(Role.OPERATOR, "anna-1234", "Anna", "127.0.0.1")


@pytest.fixture
def lease() -> Lease:
    lease = Lease()
    lease.take(ANNA.client, ANNA.name)
    return lease


@pytest.mark.parametrize(
    ("who", "words"),
    [
        (ANNA, "'Anna' (127.0.0.1)"),
        (ANNA._replace(name="renamed"), "'Anna' (127.0.0.1)"),
        (Sender(Role.OPERATOR, "ben-12345", "Ben", "127.0.0.1"), "'Ben' (127.0.0.1)"),
        (Sender(Role.OPERATOR, "zoe-12345", "script at 10.0.0.8", "10.0.0.8"), "'script at 10.0.0.8'"),
        (Sender(Role.VIEWER, "eve-12345", "Eve", "10.0.0.7"), "viewer 'Eve' (10.0.0.7)"),
    ],
)
def test_the_cause_of_a_stop_names_who_pressed_it(lease: Lease, who: Sender, words: str) -> None:
    assert stopper(lease, who) == words
