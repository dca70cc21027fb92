"""Outcome of a motion that presses on an obstacle: error of the force, and stiffness of the palpated places.

The estimates use only what a bench has: the force that the controller estimates, and the tracker. Numbers with the
prefix `true_` are those of the virtual lab.
"""

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np

from core.robot.robot import Array
from station.config.loads import Obstacle, SphereLoad, WallLoad, elastic_force
from station.config.motions import ForceMotion, PalpateMotion, PressMotion
from station.config.strict import Strict, check
from station.recording.run_outcome import rms, rounded

T = TypeVar("T", bound=Strict)
#: Distance between two points of the line along which the true stiffness is computed [m].
LINE_STEP_M = 1e-5
MOTIONS: Mapping[str, type[PressMotion]] = {"force": ForceMotion, "palpate": PalpateMotion}
OBSTACLES: Mapping[str, type[Obstacle]] = {"wall": WallLoad, "sphere": SphereLoad}


def press_of(settings: Mapping[str, Any]) -> PressMotion | None:
    """Return the motion of a run that presses, from the settings of the run; None for any other motion.

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


def press_outcome(
    of: Callable[[str], Array], motion: PressMotion, obstacle: Obstacle | None, start: float, first: float
) -> Mapping[str, Any]:
    """Return the error of the force, and after a palpation the stiffness of each place.

    A positive error is a greater force than desired. The errors of a palpation are those of the times at which its
    forces are measured.

    Args:
        of: function that returns the columns of a channel group (ticks, k).
        motion: motion of the run.
        obstacle: simulated obstacle; None without one.
        start: start of the motion [s].
        first: time after the start from which errors count [s].
    """
    times, known = of("time")[:, 0] - start, bool(of("truth_known").all())
    counted = motion.trajectory().measured(times) if isinstance(motion, PalpateMotion) else times >= first - 1e-9
    if not counted.any():
        return {}
    desired = desired_force(motion, times[counted])
    numbers: dict[str, Any] = {}
    for prefix, group in (("", "force_filtered"), *((("true_", "force_true"),) if known else ())):
        exerted = -of(group) @ motion.along
        error = exerted[counted] - desired
        numbers |= {
            f"{prefix}mean_error_N": rounded(error.mean()),
            f"{prefix}rms_error_N": rounded(rms(error)),
            f"{prefix}max_N": rounded(exerted[times >= 0.0].max()),
        }
    found: dict[str, Any] = {"press": numbers}
    if isinstance(motion, PalpateMotion):
        found["palpation"] = _palpation(of, motion, obstacle if known else None, start)
    return found


def _palpation(
    of: Callable[[str], Array], motion: PalpateMotion, obstacle: Obstacle | None, start: float
) -> dict[str, Any]:
    """Return the estimated stiffness of each place, row by row, the true one, and the relative errors."""
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


def true_stiffness(motion: PalpateMotion, obstacle: Obstacle) -> Array:
    """Return the stiffness of a simulated obstacle at each place (rows, columns) [N/m]; NaN where there is none.

    It is the difference of the two forces over the travel between them, for a tip that moves exactly along the
    direction, without friction.
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
    """Return values (places,) in the order of the visits as an array (rows, columns)."""
    grid = np.empty((motion.rows, motion.columns))
    for (row, column), value in zip(motion.grid, by_visit, strict=True):
        grid[row, column] = value
    return grid


def _listed(values: Array) -> list[list[float | None]]:
    """Return an array as lists for JSON, with null for NaN, rounded to 0.1 N/m."""
    return [[None if np.isnan(value) else round(float(value), 1) for value in row] for row in values]
