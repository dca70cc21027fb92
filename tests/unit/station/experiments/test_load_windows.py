"""The parts of a motion between two changes of its load."""

from station.config.loads import NoLoad, TapLoad, TrapezoidLoad
from station.experiments.load_windows import load_windows, window_name

LIFTED = TrapezoidLoad(magnitude=0.5, rise=1.0, stay=4.0, fall=0.5, start=2.0)


def test_each_part_of_a_motion_ends_with_the_next_change_of_the_load_or_with_the_motion():
    assert load_windows(LIFTED, 20.0) == [(2.0, 7.0), (7.0, 20.0)]
    assert load_windows(LIFTED, 5.0) == [(2.0, 5.0)]
    assert load_windows(TapLoad(peak=0.5, start=1.5), 3.0) == [(1.5, 3.0)]
    assert load_windows(NoLoad(), 3.0) == []


def test_parts_of_a_motion_are_named_by_the_time_of_the_load_change():
    assert [window_name(begin) for begin, _ in load_windows(LIFTED, 20.0)] == ["2 s", "7 s"]
