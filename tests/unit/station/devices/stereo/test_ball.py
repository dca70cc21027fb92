"""The ball is found to a small fraction of a pixel, and no other object is taken for it."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from station.devices.stereo.ball import CHANNELS, BallColour, find_ball

#: Levels of the picture behind the ball.
GREY = 110


def picture(
    centre: tuple[float, float], radius: float, colour: BallColour = "green", noise: float = 2.0, seed: int = 0
) -> NDArray[np.uint8]:
    """Return a picture with a ball: each pixel is the mean of 8 x 8 points on or beside a disc."""
    parts, (rows, columns) = 8, (120, 160)
    across = (np.arange(columns * parts) + 0.5) / parts - 0.5
    down = (np.arange(rows * parts) + 0.5) / parts - 0.5
    inside = np.hypot(across[None] - centre[0], down[:, None] - centre[1]) < radius
    cover = inside.reshape(rows, parts, columns, parts).mean(axis=(1, 3))
    ball = np.full(3, 50.0)
    ball[CHANNELS[colour]] = 200.0
    exact = GREY * (1.0 - cover[..., None]) + ball * cover[..., None]
    return np.clip(exact + np.random.default_rng(seed).normal(0.0, noise, exact.shape), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("colour", ["green", "red", "blue"])
@pytest.mark.parametrize("radius", [2.5, 5.0, 12.0])
def test_centre_is_found_to_a_twentieth_of_a_pixel(colour: BallColour, radius: float) -> None:
    random = np.random.default_rng(5)
    for seed in range(3):
        at = (float(random.uniform(30, 130)), float(random.uniform(30, 90)))
        ball = find_ball(picture(at, radius, colour, seed=seed), colour)

        assert ball is not None
        assert (ball.column, ball.row) == pytest.approx(at, abs=0.05)
        assert ball.area == pytest.approx(np.pi * radius**2, rel=0.3)


def test_noise_grey_metal_and_another_colour_are_no_ball() -> None:
    assert find_ball(picture((80.0, 60.0), 0.0, noise=6.0)) is None
    assert find_ball(picture((80.0, 60.0), 6.0, "red"), "green") is None
    metal = np.full((120, 160, 3), (150, 156, 160), np.uint8)
    assert find_ball(metal) is None


@pytest.mark.parametrize(("radius", "several"), [(5.0, True), (4.0, True), (2.5, False)])
def test_second_ball_of_the_colour_that_may_be_the_tip_is_no_position(radius: float, several: bool) -> None:
    shown = np.maximum(picture((40.0, 60.0), 5.0, noise=0.0), 0)
    shown[:, 80:] = picture((110.0, 60.0), radius, noise=0.0)[:, 80:]

    ball = find_ball(shown)

    assert ball is not None
    assert np.isinf(ball.column) == several
    assert several or (ball.column, ball.row) == pytest.approx((40.0, 60.0), abs=0.05)


def test_a_larger_stripe_of_the_same_colour_is_not_taken_for_the_ball() -> None:
    shown = picture((40.0, 60.0), 5.0)
    cv2.rectangle(shown, (80, 10), (150, 18), (50, 200, 50), -1)

    ball = find_ball(shown)

    assert ball is not None
    assert (ball.column, ball.row) == pytest.approx((40.0, 60.0), abs=0.05)
