"""Everybody reads who has pressed STOP: the operator, somebody else who might command, or a viewer."""

import pytest

from web.access.identity import Who
from web.access.lease import Lease
from web.access.tokens import Role
from web.api.commands import stopper

ANNA = Who(Role.OPERATOR, "anna-1234", "Anna", "127.0.0.1")


@pytest.fixture
def lease() -> Lease:
    lease = Lease()
    lease.take(ANNA.client, ANNA.name)
    return lease


@pytest.mark.parametrize(
    ("who", "words"),
    [
        (ANNA, "the operator"),
        (Who(Role.OPERATOR, "ben-12345", "Ben", "127.0.0.1"), "'Ben', who is not the operator"),
        (Who(Role.VIEWER, "eve-12345", "Eve", "10.0.0.7"), "a viewer, 'Eve'"),
    ],
)
def test_who_has_stopped_is_told(lease: Lease, who: Who, words: str) -> None:
    assert stopper(lease, who) == words
