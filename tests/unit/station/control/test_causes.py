"""The first cause stands until the reset; what came later is added."""

from station.control.causes import Causes


def test_what_comes_later_is_added_once() -> None:
    causes = Causes().add("the line is cut").add("stopped by the operator").add("").add("stopped by the operator")

    assert str(causes) == "the line is cut; then stopped by the operator"


def test_a_cause_that_goes_on_is_extended_wherever_it_stands() -> None:
    causes = Causes(("the tracker is silent", "axis 1 is lost")).extend("axis 1 is lost; axis 2 is lost")

    assert str(causes) == "the tracker is silent; then axis 1 is lost; axis 2 is lost"
    assert causes.extend("something else") == causes
