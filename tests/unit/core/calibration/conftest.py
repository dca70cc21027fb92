"""Fixtures of the calibration tests: the travel of the paper's stages."""

import math

import pytest

from core.robot.limits import JointLimit, Limits


@pytest.fixture(scope="session")
def paper_limits() -> Limits:
    """Return the travel limits of the paper's stages."""
    turn = (-2.0 * math.pi, 2.0 * math.pi, 0.35, 1.75)
    return Limits((
        JointLimit("outer_rotation", "rad", *turn),
        JointLimit("inner_rotation", "rad", *turn),
        JointLimit("inner_translation", "m", -0.130, -0.005, 0.02, 0.1),
    ))  # fmt: skip
