"""The numbers that may only fall, and the list of unsteady tests."""

from datetime import date

from tests.tools.ratchet import compared, overdue


def test_number_above_its_limit_fails_and_more_seconds_only_warn() -> None:
    limits = {"lines": {"product": 10}, "counts": {"sleeps": 2}, "seconds": {"live": 10}}

    assert not compared(limits, {"lines": {"product": 10}, "counts": {"sleeps": 2}, "seconds": {"live": 99}})[1]
    assert compared(limits, {"lines": {"product": 11}})[1]
    assert compared(limits, {"counts": {"sleeps": 3}})[1]


def test_unsteady_test_is_overdue_after_two_weeks_or_if_it_does_not_exist() -> None:
    entry = {"test": "tests/conftest.py::test_one", "first_seen": date(2026, 1, 1), "cause": "-", "ends_by": "-"}

    assert overdue([entry], date(2026, 1, 15)) == []
    assert "at most 14 days" in overdue([entry], date(2026, 1, 16))[0]
    assert "no such test" in overdue([{**entry, "test": "tests/gone.py"}], date(2026, 1, 2))[0]
    assert "lacks cause" in overdue([{key: entry[key] for key in entry if key != "cause"}], date(2026, 1, 2))[0]
