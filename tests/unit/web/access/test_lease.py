"""One operator at a time."""

import pytest

from web.access.lease import LENGTH, HeldError, Lease


class Anna:
    """A lease that she has, and its clock."""

    def __init__(self) -> None:
        self.now = 0.0
        self.lease = Lease(lambda: self.now)
        self.lease.take("a", "Anna")


def test_the_second_is_told_who_holds_it_and_may_take_over() -> None:
    lease = Anna().lease
    with pytest.raises(HeldError, match="'Anna' is operator"):
        lease.take("b", "Ben")
    assert lease.holds("a")
    lease.take("b", "Ben", over=True)
    assert lease.holds("b")
    assert not lease.holds("a")
    with pytest.raises(HeldError, match="'Ben' is operator"):
        lease.take("a", "Anna")


def test_it_lapses_without_a_word_and_not_with_one() -> None:
    anna = Anna()
    lease = anna.lease
    for second in range(1, 30):
        anna.now = float(second)
        lease.renew("a")
        lease.renew("b")  # somebody else's words do not count
    assert lease.left() == LENGTH
    anna.now = 29.0 + LENGTH - 0.01
    assert lease.holds("a")
    anna.now = 29.0 + LENGTH
    assert lease.holder() is None
    assert lease.left() == 0.0
    lease.renew("a")  # too late: it must be taken anew
    assert lease.holder() is None
    assert lease.take("b", "Ben").name == "Ben"


def test_only_the_holder_gives_it_back() -> None:
    lease = Anna().lease
    lease.release("b")
    assert lease.holds("a")
    lease.release("a")
    assert lease.holder() is None
    lease.release("a")


def test_a_new_name_of_the_holder_is_taken() -> None:
    assert Anna().lease.take("a", "Anna Berg").name == "Anna Berg"
