"""The parts of a motion between two changes of its load."""

from station.experiments.changes import window_name, windows
from station.lab.loads import NoLoad, TapLoad, TrapezoidLoad

LIFTED = TrapezoidLoad(magnitude=0.5, rise=1.0, stay=4.0, fall=0.5, start=2.0)


def test_each_part_ends_with_the_next_change_or_with_the_motion():
    assert windows(LIFTED, 20.0) == [(2.0, 7.0), (7.0, 20.0)]
    assert windows(LIFTED, 5.0) == [(2.0, 5.0)]
    assert windows(TapLoad(peak=0.5, start=1.5), 3.0) == [(1.5, 3.0)]
    assert windows(NoLoad(), 3.0) == []


def test_parts_are_called_by_the_time_of_their_change():
    assert [window_name(begin) for begin, _ in windows(LIFTED, 20.0)] == ["2 s", "7 s"]
