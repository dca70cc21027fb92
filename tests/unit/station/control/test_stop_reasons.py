"""Texts about the causes of a stop: the first cause is kept until the reset, and later causes are appended."""

from station.control.stop_reasons import StopReasons


def test_later_cause_of_a_stop_is_added_once() -> None:
    causes = StopReasons().add("the line is cut").add("stopped by the operator").add("").add("stopped by the operator")

    assert str(causes) == "the line is cut; then stopped by the operator"


def test_longer_text_replaces_the_cause_that_it_starts_with() -> None:
    causes = StopReasons(("the tracker is silent", "axis 1 is lost")).extend("axis 1 is lost; axis 2 is lost")

    assert str(causes) == "the tracker is silent; then axis 1 is lost; axis 2 is lost"
    assert causes.extend("something else") == causes
