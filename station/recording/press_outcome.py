"""Outcome of a motion that presses on an obstacle: error of the force, and stiffness of the palpated places.

The estimates use only data of a real bench: the force that the controller estimates, and the tracker. Numbers with the
prefix `true_` are the virtual lab's true values.
"""

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from core.robot.robot import Array
from station.config.loads import Obstacle, SphereLoad, WallLoad, elastic_force
from station.config.motions import ForceMotion, PalpateMotion, PressMotion
from station.config.strict import Strict, check
from station.control.telemetry import Channels
from station.recording.run_outcome import rms, rounded

T = TypeVar("T", bound=Strict)
#: Distance between two points of the line along which the true stiffness is computed [m].
LINE_STEP_M = 5e-5
#: Part of the desired force that counts as reached, and length of the motion's end in which the force counts [s].
REACHED, LAST_S = 0.5, 1.0
#: In contact, the force is at least this part of the smallest desired force and this number of standard deviations.
#: While the tip holds the force, the relative error is at most `HELD`.
CONTACT, CONTACT_DEVIATIONS, HELD = 0.25, 3.0, 0.1
MOTIONS: Mapping[str, type[PressMotion]] = {"force": ForceMotion, "palpate": PalpateMotion}
OBSTACLES: Mapping[str, type[Obstacle]] = {"wall": WallLoad, "sphere": SphereLoad}


def press_of(settings: Mapping[str, Any]) -> PressMotion | None:
    """Return the pressing motion of a run from the settings of the run; None for any other motion.

    Raises:
        ConfigError: the settings are invalid.
    """
    return _of_kind(settings, "trajectory", MOTIONS)


def obstacle_of(settings: Mapping[str, Any]) -> Obstacle | None:
    """Return the simulated obstacle of a run, from the settings of the run; None for any other load.

    Raises:
        ConfigError: the settings are invalid.
    """
    return _of_kind(settings, "load", OBSTACLES)


def _of_kind(settings: Mapping[str, Any], key: str, kinds: Mapping[str, type[T]]) -> T | None:
    table = settings.get(key) or {}
    chosen = kinds.get(table.get("kind", ""))
    return None if chosen is None else check(chosen, table, key)


def desired_force(motion: PressMotion, times: Array) -> Array:
    """Return the desired force [N] at `times` (m,) [s] since the motion's start; NaN while the tip does not press."""
    if isinstance(motion, PalpateMotion):
        return motion.trajectory().desired_force(times)
    return np.full(len(times), motion.force)


def in_contact(of: Callable[[str], Array], motion: PressMotion) -> NDArray[np.bool_]:
    """Return whether the estimated force shows contact at each tick (ticks,); `of` as in `press_outcome`.

    Contact is a force of at least `CONTACT` times the smallest desired force and `CONTACT_DEVIATIONS` deviations.
    """
    exerted, variance = -of("force_filtered") @ motion.along, of("force_variance") @ motion.along**2
    smallest = motion.light if isinstance(motion, PalpateMotion) else motion.force
    return exerted >= np.maximum(CONTACT * smallest, CONTACT_DEVIATIONS * np.sqrt(variance))


def press_outcome(
    of: Callable[[str], Array], motion: PressMotion, obstacle: Obstacle | None, start: float, first: float
) -> Mapping[str, Any]:
    """Return the error of the force, and after a palpation the stiffness of each place.

    A positive error is a greater force than desired. Errors count from `first` on, but not before the estimated force
    has reached 90 % of the desired force. In a palpation they count while its forces are measured. The largest force
    and the times of contact and holding count from the motion's start, because a force is largest at first contact.

    Args:
        of: function that returns the columns of a channel group (ticks, k).
        motion: motion of the run.
        obstacle: simulated obstacle; None without one.
        start: start of the motion [s].
        first: time after the start from which errors count [s].
    """
    times, known = of("time")[:, 0] - start, bool(of("truth_known").all())
    if isinstance(motion, PalpateMotion):
        counted = motion.trajectory().measured(times)
    else:
        reached = (times >= 0.0) & (-of("force_filtered") @ motion.along >= (1.0 - HELD) * motion.force)
        counted = times >= max(first, times[reached.argmax()] if reached.any() else 0.0) - 1e-9
    if not counted.any():
        return {}
    desired = desired_force(motion, times[counted])
    numbers: dict[str, Any] = {"desired_N": motion.force}
    if not isinstance(motion, PalpateMotion):
        numbers["counted_from_s"] = round(float(times[counted.argmax()]), 3)
    for prefix, group in (("", "force_filtered"), *((("true_", "force_true"),) if known else ())):
        exerted = -of(group) @ motion.along
        error = exerted[counted] - desired
        numbers |= {
            f"{prefix}mean_error_N": rounded(error.mean()),
            f"{prefix}rms_error_N": rounded(rms(error)),
            f"{prefix}max_N": rounded(exerted[times >= 0.0].max()),
        }
        if not isinstance(motion, PalpateMotion):
            touching = exerted >= CONTACT * motion.force if prefix else in_contact(of, motion)
            found = _contact(touching & (times >= 0.0), exerted, times, motion.force)
            numbers |= {f"{prefix}{name}": time for name, time in found.items()}
    if isinstance(motion, PalpateMotion):
        return {"press": numbers, "palpation": _palpation(of, motion, obstacle if known else None, start)}
    return {"press": numbers}


def counted_text(press: Mapping[str, Any]) -> str:
    """Return a text about the times at which the force's errors count; `press` is a part of a summary."""
    return f"from {press['counted_from_s']:g} s on" if "counted_from_s" in press else "while forces are measured"


def _contact(touching: NDArray[np.bool_], exerted: Array, times: Array, force: float) -> dict[str, float]:
    """Return when contact started and how long the tip held the desired force [s]; empty without contact."""
    if not touching.any():
        return {}
    held = (times >= 0.0) & (np.abs(exerted - force) <= HELD * force)
    step = (times[-1] - times[0]) / max(len(times) - 1, 1)
    return {"contact_s": round(float(times[touching.argmax()]), 3), "held_s": round(float(held.sum() * step), 3)}


def force_not_reached(of: Callable[[str], Array], motion: PressMotion, start: float) -> str:
    """Return why the force of a motion was not reached, in one line; empty if it was reached.

    It counts as reached if the mean estimated force of the last second is at least `REACHED` times the desired force.
    In a palpation, the largest force counts instead of the mean. For the arguments see `press_outcome`.
    """
    times, exerted = of("time")[:, 0], -of("force_filtered") @ motion.along
    moving = times >= start - 1e-9
    last = moving & (times > times[-1] - LAST_S)
    if not last.any():
        return ""
    largest = float(exerted[moving].max())
    found = largest if isinstance(motion, PalpateMotion) else float(exerted[last].mean())
    if found >= REACHED * motion.force:
        return ""
    return (
        f"the desired force {motion.force:.3g} N was not reached: at most {largest:.2g} N, at the end"
        f" {float(exerted[last].mean()):.2g} N; start nearer to the obstacle, or allow more time or reach"
    )


def _palpation(
    of: Callable[[str], Array], motion: PalpateMotion, obstacle: Obstacle | None, start: float
) -> dict[str, Any]:
    """Return the estimated and the true stiffness of each place, row by row, and the relative errors."""
    estimated = estimated_stiffness(of, motion, start)
    found: dict[str, Any] = {"stiffness_N_per_m": _listed(estimated)}
    if obstacle is not None:
        true = true_stiffness(motion, obstacle)
        error = (estimated / true - 1.0)[np.isfinite(estimated) & np.isfinite(true)]
        found["true_stiffness_N_per_m"] = _listed(true)
        if len(error):
            found |= {"rms_relative_error": rounded(rms(error)), "max_relative_error": rounded(np.abs(error).max())}
    return found


def estimated_stiffness(of: Callable[[str], Array], motion: PalpateMotion, start: float) -> Array:
    """Return the stiffness of each place (rows, columns) from measured force and tip [N/m]; NaN where unknown."""
    frames = of("tip_new")[:, 0] > 0.0
    by_visit = motion.trajectory().stiffness(
        of("time")[:, 0] - start,
        -of("force_filtered") @ motion.along,
        of("tip_time")[frames, 0] - start,
        of("tip_measured")[frames] @ motion.along,
    )
    return _on_grid(motion, by_visit)


class PalpationSoFar:
    """Computes the stiffness of the places that a palpation has measured so far, from the new rows of its run."""

    def __init__(self, motion: PalpateMotion, channels: Channels) -> None:
        self._motion, self._channels = motion, channels
        self._blocks = {name: [channels.of(np.empty((0, len(channels))), name)] for name in _MEASURED}

    def add(self, rows: Array) -> None:
        """Add the next rows (m, channels)."""
        for name, blocks in self._blocks.items():
            blocks.append(self._channels.of(rows, name).copy())

    def stiffness(self, start: float) -> list[list[float | None]]:
        """Return the stiffness of each place, row by row [N/m]; None where it is not known yet.

        `start`: start of the motion [s].
        """
        for blocks in self._blocks.values():
            blocks[:] = [np.concatenate(blocks)]
        return _listed(estimated_stiffness(lambda name: self._blocks[name][0], self._motion, start))


#: Fields from which the stiffness is estimated.
_MEASURED = ("time", "force_filtered", "tip_new", "tip_time", "tip_measured")


def true_stiffness(motion: PalpateMotion, obstacle: Obstacle) -> Array:
    """Return the stiffness of a simulated obstacle at each place (rows, columns) [N/m]; NaN: force not reached.

    It is the difference of the two forces divided by the travel between them. The tip is assumed to move exactly along
    the direction, without friction.
    """
    line = np.arange(-motion.reach, motion.reach, LINE_STEP_M)

    def at(row: int, column: int) -> float:
        points = motion.place(row, column) + line[:, None] * motion.along
        force = np.array([-elastic_force(obstacle, point) @ motion.along for point in points])
        if not force.max() >= motion.force:
            return np.nan
        rising = slice(0, int(np.argmax(force >= motion.force)) + 1)
        light, firm = np.interp((motion.light, motion.force), force[rising], line[rising])
        return (motion.force - motion.light) / (firm - light)

    return _on_grid(motion, np.array([at(row, column) for row, column in motion.grid]))


def _on_grid(motion: PalpateMotion, by_visit: Array) -> Array:
    """Return the values of all places as an array (rows, columns); `by_visit` has them in the order of the visits."""
    grid = np.empty((motion.rows, motion.columns))
    for (row, column), value in zip(motion.grid, by_visit, strict=True):
        grid[row, column] = value
    return grid


def _listed(values: Array) -> list[list[float | None]]:
    """Return an array as lists for JSON, with null for NaN, rounded to 0.1 N/m."""
    return [[None if np.isnan(value) else round(float(value), 1) for value in row] for row in values]
