"""One operator at a time."""

import pytest

from web.lease import LENGTH, HeldError, Lease


def test_the_second_is_told_who_holds_it_and_may_take_over() -> None:
    lease = Lease()
    lease.take("a", "Anna", 0.0)
    with pytest.raises(HeldError, match="'Anna' is operator"):
        lease.take("b", "Ben", 1.0)
    assert lease.holds("a", 1.0)
    lease.take("b", "Ben", 2.0, over=True)
    assert lease.holds("b", 2.0)
    assert not lease.holds("a", 2.0)
    with pytest.raises(HeldError, match="'Ben' is operator"):
        lease.take("a", "Anna", 3.0)


def test_it_lapses_without_a_word_and_not_with_one() -> None:
    lease = Lease()
    lease.take("a", "Anna", 0.0)
    for second in range(1, 30):
        lease.renew("a", float(second))
        lease.renew("b", float(second))  # somebody else's words do not count
    assert lease.holds("a", 29.0 + LENGTH - 0.01)
    assert lease.holder(29.0 + LENGTH) is None
    lease.renew("a", 40.0)  # too late: it must be taken anew
    assert lease.holder(40.0) is None
    assert lease.take("b", "Ben", 41.0).name == "Ben"


def test_only_the_holder_gives_it_back() -> None:
    lease = Lease()
    lease.take("a", "Anna", 0.0)
    lease.release("b", 1.0)
    assert lease.holds("a", 1.0)
    lease.release("a", 1.0)
    assert lease.holder(1.0) is None
    lease.release("a", 1.0)


def test_a_new_name_of_the_holder_is_taken() -> None:
    lease = Lease()
    lease.take("a", "Anna", 0.0)
    assert lease.take("a", "Anna Berg", 1.0).name == "Anna Berg"
