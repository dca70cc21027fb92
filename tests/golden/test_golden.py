"""The golden cases reproduce the numbers that are stored in the file."""

import pytest

from tests.golden.cases import CASES
from tests.golden.record import REASON, Record, changed, expected, machine, record, records, report


@pytest.fixture(scope="module")
def found() -> dict[str, Record]:
    return records()


def test_recorded_numbers_of_every_golden_case_are_those_of_the_file(found: dict[str, Record]) -> None:
    wrote, known = expected()
    lines = [*report(known, found, bits=wrote == machine())]
    assert not lines, "\n".join((f"{len(lines)} of {len(found)} cases changed. {REASON}", *lines))


def test_samples_of_the_file_are_those_of_the_golden_cases_on_any_machine(found: dict[str, Record]) -> None:
    _, known = expected()
    assert not [*report(known, found, bits=False)]


def test_the_file_has_every_golden_case_and_no_other() -> None:
    assert set(expected()[1]) == set(CASES)


def test_a_changed_bit_and_a_changed_sample_are_reported_with_their_channel(found: dict[str, Record]) -> None:
    _, known = expected()
    name, channel = "fig10 paper", "tip_true.x"
    one = found[name]
    bit = one._replace(channels={**one.channels, channel: "00000000"})
    far = one._replace(samples={**one.samples, channel: [value + 1e-6 for value in one.samples[channel]]})
    assert changed(known[name], bit, bits=True) == [channel]
    assert changed(known[name], bit, bits=False) == []
    assert changed(known[name], far, bits=False) == [channel]


def test_a_missing_and_a_new_case_are_reported(found: dict[str, Record]) -> None:
    _, known = expected()
    less, more = dict(found), {**found, "new": record({})}
    del less["fig10 paper"]
    assert [*report(known, less, bits=False)] == ["fig10 paper: the case is missing"]
    assert [*report(known, more, bits=False)] == ["new: a new case"]
