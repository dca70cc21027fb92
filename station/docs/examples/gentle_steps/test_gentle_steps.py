"""The tip reaches a step of every size."""

from gentle_steps import errors


def test_tip_reaches_steps_of_every_size():
    found = dict(errors())
    assert list(found) == ["small", "middle", "large"]
    assert max(found.values()) < 0.5  # [mm]; without control the error would be the step, 2 mm or more
