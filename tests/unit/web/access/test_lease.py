"""The operator's lease: one operator at a time."""

import pytest

from web.access.lease import LEASE_S, Lease, LeaseHeldError


class Anna:
    """The lease of client `a`, with a clock `now` [s] that the test sets."""

    def __init__(self) -> None:
        self.now = 0.0
        self.lease = Lease(lambda: self.now)
        self.lease.take("a", "Anna")


def test_a_second_client_gets_the_operators_name_and_may_take_over() -> None:
    lease = Anna().lease
    with pytest.raises(LeaseHeldError, match="'Anna' is operator"):
        lease.take("b", "Ben")
    assert lease.holds("a")
    lease.take("b", "Ben", over=True)
    assert lease.holds("b")
    assert not lease.holds("a")
    with pytest.raises(LeaseHeldError, match="'Ben' is operator"):
        lease.take("a", "Anna")


def test_the_operator_lease_expires_only_without_requests() -> None:
    anna = Anna()
    lease = anna.lease
    for second in range(1, 30):
        anna.now = float(second)
        lease.renew("a")
        lease.renew("b")  # requests of another client do not renew the lease
    assert lease.left() == LEASE_S
    anna.now = 29.0 + LEASE_S - 0.01
    assert lease.holds("a")
    anna.now = 29.0 + LEASE_S
    assert lease.holder() is None
    assert lease.left() == 0.0
    lease.renew("a")  # a renewal after expiry has no effect: the client must take the lease again
    assert lease.holder() is None
    assert lease.take("b", "Ben").name == "Ben"


def test_only_the_operator_releases_the_lease() -> None:
    lease = Anna().lease
    lease.release("b")
    assert lease.holds("a")
    lease.release("a")
    assert lease.holder() is None
    lease.release("a")


def test_the_operator_can_change_its_name() -> None:
    assert Anna().lease.take("a", "Anna Berg").name == "Anna Berg"


def test_tenure_of_an_operator_ends_by_release_take_over_and_expiry_and_not_by_renewal() -> None:
    anna = Anna()
    lease = anna.lease
    first = lease.take("a", "Anna Berg")
    anna.now = 5.0
    lease.renew("a")
    lease.keep("a", "Anna")
    assert lease.ended(first) == ""
    anna.now = 5.0 + LEASE_S
    assert lease.ended(first) == "the operator 'Anna Berg' has left"
    second = lease.take("a", "Anna")
    assert lease.ended(first) == "the operator 'Anna Berg' has left"
    assert lease.ended(second) == ""
    third = lease.take("b", "Ben", over=True)
    assert lease.ended(second) == "'Ben' is operator instead of 'Anna'"
    lease.release("b")
    assert lease.ended(third) == "the operator 'Ben' has left"
