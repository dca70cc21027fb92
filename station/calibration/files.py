"""Writes the files of a calibration to one folder: registration, sensors, robot, and the previous robot file.

Values are SI; intervals are 95 %. `station.control.bench_calibration` reads the files back.
"""

import contextlib
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from core.calibration.fit import Fit
from core.calibration.force import SensorCalibration
from core.calibration.prediction import Frames
from core.calibration.rigid_transform import CoilAxis, RigidTransform, vector_from_rotation
from core.calibration.tubes import TubeCalibration
from core.robot.robot import Array, Robot
from station.config.robots import RobotFile
from station.config.strict import FORMAT, ConfigError, Strict, read_text, toml_lines, toml_string
from station.control.calibrated_robot import (
    DESCRIBED_FILE,
    KINDS,
    LATENCY_FILE,
    REGISTRATION_FILE,
    RESIDUAL_FILE,
    ROBOT_FILE,
    SENSORS_FILE,
)
from station.devices.aurora.tracker import TrackerMounting

#: File names of the measurements, the numbers and the report.
VISITS_FILE, REPORT_NUMBERS_FILE, REPORT_FILE = "visits.json", "report.json", "report.html"


def new_folder(out: Path, name: str) -> Path:
    """Create a new folder in `out`; a number is appended if the name exists.

    The folder is created before its files, which reserves its name.

    Raises:
        ConfigError: `out` cannot be written to.
    """
    number = 1
    try:
        out.mkdir(parents=True, exist_ok=True)
        while True:
            path = out / (name if number == 1 else f"{name}-{number}")
            with contextlib.suppress(FileExistsError):
                path.mkdir()
                return path
            number += 1
    except OSError as error:
        raise ConfigError(f"{out}: cannot write results there: {error.strerror}") from None


def carry_over(known: Path, folder: Path) -> list[Path]:
    """Copy the files of an earlier calibration that are missing in `folder`, and return the copies.

    Raises:
        ConfigError: a file cannot be read or written.
    """
    # The residual belongs to the tubes and frames with which it was learned.
    outdated = {RESIDUAL_FILE} if any((folder / name).exists() for name in (REGISTRATION_FILE, ROBOT_FILE)) else set()
    return [
        _write(folder / name, read_text(known / name))
        for name in (*KINDS, DESCRIBED_FILE)
        if name not in outdated and (known / name).is_file() and not (folder / name).exists()
    ]


def write_registration(
    folder: Path, robot: Robot, frames: Frames, fit: Fit, errors: Array, assumed: TrackerMounting, made: str,
    axis: CoilAxis | None = None,
) -> Path:  # fmt: skip
    """Write the registration: the fitted rigid motion, combined with the assumed mounting in the measurements."""
    whole = frames.registration.after(RigidTransform(assumed.rotation, assumed.position))
    names = [parameter.name for parameter in fit.parameters]
    first = names.index("frame rotation x")
    half = 1.96 * fit.errors[first : first + 6]
    text = f"""# Pose of the tracker: p_robot = R(rotation_vector) p_tracker + position.
# The rotation about z is relative to the zero angle of the outermost tube, and z to its straight length.
format = {FORMAT}
robot = {toml_string(robot.name)}
made = {toml_string(made)}
rotation_vector = {_row(vector_from_rotation(whole.rotation))}  # [rad]
position = {_row(whole.position)}  # [m]
coil = {_row(frames.coil)}  # in the frame of the innermost tube's tip [m]
{_axis(axis)}rms_error = {math.sqrt(float(np.mean(errors**2))):.3g}  # [m]
rotation_interval = {_row(half[:3], 3)}  # half width of the 95 % interval [rad]
position_interval = {_row(half[3:], 3)}  # [m]
"""
    return _write(folder / REGISTRATION_FILE, text)


def write_sensors(folder: Path, robot: Robot, found: SensorCalibration, made: str) -> Path:
    """Write mounting and hanging weight of each sensor."""
    lines = [
        "# Mounting of the base sensors and the weights that hang on them; every run tares the offsets.",
        f"format = {FORMAT}",
        f"robot = {toml_string(robot.name)}",
        f"made = {toml_string(made)}",
        f"gravity = {_row(found.sensors.gravity)}  # plate's frame",
    ]
    skew = np.zeros((len(robot.sensor_names), 6, 6)) if found.sensors.skew is None else found.sensors.skew
    hanging = [
        (
            f"weight = {found.sensors.weight[i]:.6g}  # [N], +-{found.fit.interval(f'{tube.name} weight'):.2g}",
            f"first_moment = {_row(found.sensors.first_moment[i])}  # [N m]",
        )
        for i, tube in enumerate(robot.tubes)
    ]
    if robot.sensed == "robot":
        for tube, weight in zip(robot.tubes, hanging, strict=True):
            lines += ["", f"[robot_sensor.weights.{tube.name}]", *weight]
    for i, name in enumerate(robot.sensor_names):
        turn = found.fit.interval(f"{name} mounting z")
        lines += [
            "",
            "[robot_sensor]" if name == "robot" else f"[tubes.{name}]",
            f"mounting = {_row(vector_from_rotation(found.sensors.mounting[i]))}  # [rad], about z +-{turn:.2g} (95 %)",
            *(() if name == "robot" else hanging[i]),
            "skew = [  # part of each reading that is gain and cross-talk [N, N m by N, N m]",
            *(f"    {_row(row, 6)}," for row in skew[i]),
            "]",
            f"# drift while it was calibrated: {_row(60e3 * found.drift[i, :3], 3)} mN/min",
        ]
    return _write(folder / SENSORS_FILE, "\n".join(lines) + "\n")


def write_latency(folder: Path, added: float, made: str) -> Path:
    """Write the latency `added` that the tracker has in addition to the configured one [s]."""
    lines = toml_lines({"format": FORMAT, "made": made, "added": round(added, 6)})
    return _write(folder / LATENCY_FILE, "\n".join(["# Latency of the tracker.", *lines]) + "\n")


def write_robot(folder: Path, described: RobotFile, found: TubeCalibration, made: str) -> Path:
    """Write the robot file with the calibrated tubes; comments have the previous values and the intervals.

    Every key of the file is written: calibrated values replace the previous ones, all others are copied.
    """
    file = described.model_copy(update={"format": FORMAT, "source": f"calibrated: {made}"})
    tubes = [_tube(described, found, index) for index in range(len(described.tubes))]
    return _write(folder / ROBOT_FILE, robot_text(file, tubes))


def write_described(folder: Path, described: RobotFile) -> Path:
    """Write the robot's file for which a calibration is made, to find later changes of it."""
    text = f"# The robot's file for which this calibration was made.\n{robot_text(described)}"
    return _write(folder / DESCRIBED_FILE, text)


def robot_text(file: RobotFile, tubes: Sequence[Sequence[str]] = ()) -> str:
    """Return a robot as the TOML text of its file; `tubes` are lines for each tube, if they have comments."""
    tubes = tubes or [toml_lines(tube.model_dump()) for tube in file.tubes]
    lines: list[str] = []
    tables: list[str] = []
    for key in type(file).model_fields:
        value = getattr(file, key)
        if key == "tubes":
            for tube in tubes:
                tables += ["", "[[tubes]]", *tube]
        elif isinstance(value, Strict):
            tables += ["", f"[{key}]", *toml_lines(value.model_dump())]
        elif isinstance(value, tuple) and all(isinstance(part, Strict) for part in value):
            tables += [line for part in value for line in ("", f"[[{key}]]", *toml_lines(part.model_dump()))]
        else:
            lines += toml_lines({key: value})
    return "\n".join(lines + tables) + "\n"


def _tube(described: RobotFile, found: TubeCalibration, index: int) -> list[str]:
    """Return the lines of one tube: every key, in the order of the model `TubeFile`."""
    tube, new = described.tubes[index], found.robot.tubes[index]
    fitted = {quantity.kind for quantity in found.what if quantity.tube == index}
    start, last = "curve_start" if "curve_start" in fitted else "straight_length", len(new.sections) - 1

    def was(kind: str, old: float, scale: float, unit: str) -> str:
        if kind not in fitted:
            return f"  # {unit}, as described"
        interval = abs(scale) * found.fit.interval(f"{tube.name} {kind}")
        return f"  # {unit}, +-{interval:.2g} (95 %); described {old:g}"

    lines: list[str] = []
    for key in type(tube).model_fields:
        if key == "sections":
            lines.append("sections = [")
            for number, (old, section) in enumerate(zip(tube.sections, new.sections, strict=True)):
                bent, before = math.hypot(*section.curvature), math.hypot(*old.curvature)
                comment = was("curvature", before, before, f"{bent:.5g} 1/m") if before else ""
                if number == last and "end" in fitted:
                    comment += was("end", old.length, 1.0, "[m] to where its neighbour leaves it")
                elif not before:
                    comment = was(start if number == 0 else "", old.length, 1.0, "[m]")
                values = old.model_dump() | {"length": section.length, "curvature": section.curvature}
                lines.append(f"    {{ {', '.join(toml_lines(_rounded(values)))} }},{comment}")
            lines.append("]")
            continue
        value, comment = getattr(new, key, getattr(tube, key)), ""
        if key == "bending_stiffness":
            comment = was(key, tube.bending_stiffness, tube.bending_stiffness, "[N m^2]")
        elif key == "poisson_ratio" and new.torsional_stiffness is None:
            comment = was(key, tube.poisson_ratio, 1.0, "GJ = EI / (1 + nu)")
        elif key == "torsional_stiffness" and new.torsional_stiffness is not None:
            torsion = tube.torsional_stiffness or tube.bending_stiffness / (1.0 + tube.poisson_ratio)
            comment = was(key, torsion, torsion, "GJ [N m^2]")
            if key not in fitted and "bending_stiffness" in fitted:
                comment = "  # GJ [N m^2], in the described ratio to EI"
        calibrated = key in ("bending_stiffness", "poisson_ratio", "torsional_stiffness")
        lines += [line + comment for line in toml_lines(_rounded({key: value}) if calibrated else {key: value})]
    return lines


def _rounded(values: Mapping[str, Any]) -> dict[str, Any]:
    """Round calibrated numbers to nine digits, which keeps the shorter numbers that people write in files."""

    def nine(value: Any) -> Any:
        if isinstance(value, tuple):
            return tuple(map(nine, value))
        return float(f"{value:.9g}") if isinstance(value, float) else value

    return {key: nine(value) for key, value in values.items()}


def _axis(axis: CoilAxis | None) -> str:
    """Return the line of the coil's axis, if there is one."""
    if axis is None or axis.refused:
        return ""
    return f"axis = {_row(axis.direction)}  # of the coil, in that frame; spread over poses {axis.spread:.2g} rad\n"


def _write(path: Path, text: str) -> Path:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from None
    return path


def _row(values: Sequence[float] | Array, digits: int = 9) -> str:
    return "[" + ", ".join(f"{float(value):#.{digits}g}" if value else "0.0" for value in values) + "]"
