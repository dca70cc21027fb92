"""The monitor of the tracker's frames measures their noise, and ends a motion whose frames the observer cannot use."""

import re

import numpy as np
import pytest

from core.control.observer import Observer
from station.control.tracker_monitor import JUDGED_FRAMES, MAX_UNUSED, TrackerMonitor

PERIOD, TICKS = 0.002, 12


class Frames:
    """A tip in motion with a model that differs from it, a tracker with noise, and the monitor of its frames."""

    def __init__(self, speed: float = 0.02) -> None:
        self.observer, self.monitor = Observer(PERIOD), TrackerMonitor()
        self._random, self._time, self._speed = np.random.default_rng(3), 0.0, speed
        self._state = self.observer.start(self._model(0.0), self._true(0.0))

    def _model(self, time: float) -> np.ndarray:
        return np.array([self._speed * np.sin(time), self._speed * time, 0.0])

    def _true(self, time: float) -> np.ndarray:
        return self._model(time) + np.array([1e-3 * time, 5e-3, 2e-3 * np.sin(time)])

    def arrive(self, count: int, noise: float = 1e-4, age: float = 0.024, offset: float = 0.0) -> list[str]:
        """Let frames arrive; return what the monitor says after each of them."""
        said = []
        for _ in range(count):
            for tick in range(TICKS):
                self._time += PERIOD
                tip = None
                if tick == TICKS - 1:
                    tip = self._true(self._time - age) + noise * self._random.normal(size=3) + [offset, 0.0, 0.0]
                self._state = self.observer.update(self._state, self._model(self._time), tip, age)
            self.monitor.update(self.observer, self._state, tip, age)
            said.append(self.monitor.check())
        return said


@pytest.mark.parametrize("noise", [1e-5, 1e-4, 1e-3, 1e-2])
def test_the_noise_is_measured_while_tip_and_model_move(noise):
    frames = Frames()
    found = []
    for _ in range(20):
        frames.arrive(JUDGED_FRAMES, noise)
        found.append(frames.monitor.noise)
    assert np.mean(found) == pytest.approx(noise, rel=0.1)
    assert max(found) < 1.6 * noise


def test_usual_frames_cause_neither_a_warning_nor_an_end():
    frames = Frames()
    assert not any(frames.arrive(1000))
    assert frames.monitor.warning == ""


@pytest.mark.parametrize("size", [0.005, 0.05])
def test_a_single_jump_that_lasts_ends_no_motion(size):
    frames = Frames()
    frames.arrive(JUDGED_FRAMES + 2)
    assert not any(frames.arrive(400, offset=size))
    assert frames.monitor.warning == ""


def test_larger_noise_is_named_and_noise_that_most_frames_do_not_survive_ends_a_motion():
    frames = Frames()
    assert not any(frames.arrive(100, noise=4e-4))
    assert re.match(r"the tracker's frames scatter by 0\.\d+ mm \(expected 0\.1 mm\): move", frames.monitor.warning)
    said = frames.arrive(100, noise=2e-3)
    assert "so they cannot correct the tip: move metal" in said[-1]
    assert next(place for place, text in enumerate(said) if text) < JUDGED_FRAMES


def test_frames_that_are_too_old_end_a_motion_with_their_age():
    frames = Frames()
    frames.arrive(JUDGED_FRAMES)
    said = frames.arrive(MAX_UNUSED + 1, age=0.14)
    assert not any(said[:-1])
    assert "arrive 140 ms after their measurement, and only frames up to 128 ms can be used" in said[-1]


def test_frames_that_jump_back_and_forth_end_a_motion():
    frames = Frames()
    frames.arrive(JUDGED_FRAMES)
    said = [frames.arrive(1, offset=0.005 * (-1) ** place)[0] for place in range(JUDGED_FRAMES)]
    assert "so they cannot correct the tip" in said[-1]


def test_a_tip_that_a_load_moves_quickly_ends_no_motion():
    frames = Frames()
    frames.arrive(JUDGED_FRAMES)
    assert not any(text for place in range(30) for text in frames.arrive(1, offset=2e-3 * place))
    assert not any(frames.arrive(100, offset=0.06))


def test_only_frames_of_the_present_motion_count_as_not_used():
    frames = Frames()
    frames.arrive(MAX_UNUSED, age=0.14)
    frames.monitor.begin()
    assert not any(frames.arrive(MAX_UNUSED, age=0.14))
    assert frames.arrive(1, age=0.14)[0]
