"""What a calibration leaves behind: registration.toml, sensors.toml and robot.toml in one folder, with provenance.

Values are SI; intervals are 95 %. `station.control.known_calibration` reads the files back.
"""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from core.calibration.coil_axis import CoilAxis
from core.calibration.fit import Fit
from core.calibration.force import SensorCalibration
from core.calibration.prediction import Frames
from core.calibration.rigid import Rigid, vector_of
from core.calibration.tubes import TubeCalibration
from core.robot.robot import Array, Robot
from station.config.robots import RobotFile
from station.config.strict import FORMAT, ConfigError
from station.config.toml_text import toml_string
from station.control.known_calibration import REGISTRATION, ROBOT, SENSORS
from station.devices.aurora.tracker import Registration


def carry_over(known: Path, folder: Path) -> list[Path]:
    """Copy what an earlier calibration found and `folder` does not have: the copies.

    Raises:
        ConfigError: a file cannot be read or written.
    """
    copies: list[Path] = []
    for name in (REGISTRATION, SENSORS, ROBOT):
        if (known / name).is_file() and not (folder / name).exists():
            try:
                text = (known / name).read_text(encoding="utf-8")
            except OSError as error:
                raise ConfigError(f"{known / name}: cannot be read: {error.strerror}") from None
            copies.append(_write(folder / name, text))
    return copies


def write_registration(
    folder: Path, robot: Robot, frames: Frames, fit: Fit, errors: Array, assumed: Registration, made: str,
    axis: CoilAxis | None = None,
) -> Path:  # fmt: skip
    """The found motion after the assumed one: measurements were seen through the latter."""
    whole = frames.registration.after(Rigid(assumed.rotation, assumed.position))
    names = [parameter.name for parameter in fit.parameters]
    first = names.index("frame rotation x")
    half = 1.96 * fit.errors[first : first + 6]
    text = f"""# Where the tracker stands: p_robot = R(rotation_vector) p_tracker + position.
# The turn about z is counted from the zero angle of the outermost tube, z from the plate as its straight part has it.
format = {FORMAT}
robot = {toml_string(robot.name)}
made = {toml_string(made)}
rotation_vector = {_row(vector_of(whole.rotation))}  # [rad]
position = {_row(whole.position)}  # [m]
coil = {_row(frames.coil)}  # in the frame of the innermost tube's tip [m]
{_axis(axis)}rms_error = {math.sqrt(float(np.mean(errors**2))):.3g}  # [m]
rotation_interval = {_row(half[:3], 3)}  # half of 95 % [rad]
position_interval = {_row(half[3:], 3)}  # [m]
"""
    return _write(folder / REGISTRATION, text)


def write_sensors(folder: Path, robot: Robot, found: SensorCalibration, made: str) -> Path:
    """Mounting and hanging weight of each sensor."""
    lines = [
        "# How the base sensors stand and what hangs on them; offsets are tared before every run.",
        f"format = {FORMAT}",
        f"robot = {toml_string(robot.name)}",
        f"made = {toml_string(made)}",
        f"gravity = {_row(found.sensors.gravity)}  # plate's frame",
    ]
    skew = np.zeros((len(robot.tubes), 6, 6)) if found.sensors.skew is None else found.sensors.skew
    for i, tube in enumerate(robot.tubes):
        turn = found.fit.interval(f"{tube.name} mounting z")
        lines += [
            "",
            f"[tubes.{tube.name}]",
            f"mounting = {_row(vector_of(found.sensors.mounting[i]))}  # [rad], about z +-{turn:.2g} (95 %)",
            f"weight = {found.sensors.weight[i]:.6g}  # [N], +-{found.fit.interval(f'{tube.name} weight'):.2g}",
            f"first_moment = {_row(found.sensors.first_moment[i])}  # [N m]",
            "skew = [  # part of each reading that is gain and cross-talk [N, N m by N, N m]",
            *(f"    {_row(row, 6)}," for row in skew[i]),
            "]",
            f"# drift while it was calibrated: {_row(60e3 * found.drift[i, :3], 3)} mN/min",
        ]
    return _write(folder / SENSORS, "\n".join(lines) + "\n")


def write_robot(folder: Path, described: RobotFile, found: TubeCalibration, made: str) -> Path:
    """The described robot with its tubes as they were found; what it was and how sure beside each number."""
    fit, lines = found.fit, [f"# {line}" for line in made.splitlines()]
    lines += [
        f"format = {FORMAT}",
        f"name = {toml_string(described.name)}",
        f"source = {toml_string(f'calibrated: {made}')}",
    ]
    if described.max_force is not None:
        lines.append(f"max_force = {described.max_force!r}")
    if described.working_pose is not None:
        pose = ", ".join(f"{toml_string(name)} = {value!r}" for name, value in described.working_pose.items())
        lines.append(f"working_pose = {{ {pose} }}")
    lines += ["", "[base]", f"position = {_row(described.base.position)}"]
    lines.append(f"rotation_vector = {_row(described.base.rotation_vector)}")
    if described.workspace is not None:
        lines += ["", "[workspace]", f"lower = {_row(described.workspace.lower)}"]
        lines.append(f"upper = {_row(described.workspace.upper)}")
    for i, (tube, new) in enumerate(zip(described.tubes, found.robot.tubes, strict=True)):

        def was(kind: str, old: float, scale: float, unit: str, tube_index: int = i, name: str = tube.name) -> str:
            if not any(quantity.tube == tube_index and quantity.kind == kind for quantity in found.what):
                return f"  # {unit}, as described"
            return f"  # {unit}, +-{abs(scale) * fit.interval(f'{name} {kind}'):.2g} (95 %); described {old:g}"

        stiffness = tube.bending_stiffness
        lines += ["", "[[tubes]]", f"name = {toml_string(tube.name)}"]
        comment = was("bending_stiffness", stiffness, stiffness, "[N m^2]")
        lines.append(f"bending_stiffness = {new.bending_stiffness:.8g}{comment}")
        if new.torsional_stiffness is None:
            nu = was("poisson_ratio", tube.poisson_ratio, 1.0, "GJ = EI / (1 + nu)")
            lines.append(f"poisson_ratio = {new.poisson_ratio:.6g}{nu}")
        else:
            lines.append(f"torsional_stiffness = {new.torsional_stiffness:.8g}")
        lines += [f"rotation = {new.rotation!r}", f"translation = {new.translation!r}"]
        lines += [
            f"outer_diameter = {new.outer_diameter!r}",
            f"inner_diameter = {new.inner_diameter!r}",
            f"density = {tube.density!r}",
            "sections = [",
        ]
        for old, section in zip(tube.sections, new.sections, strict=True):
            bent, before = math.hypot(*section.curvature), math.hypot(*old.curvature)
            comment = (
                was("curvature", before, before, f"{bent:.5g} 1/m")
                if before
                else was("straight_length", old.length, 1.0, "[m]")
            )
            if section.length != old.length and before:
                comment += was("end", old.length, 1.0, "[m] to where its neighbour leaves it")
            lines.append(f"    {{ length = {section.length:.8g}, curvature = {_row(section.curvature)} }},{comment}")
        lines.append("]")
    for joint in described.joints:
        lines += ["", "[[joints]]", f"name = {toml_string(joint.name)}", f"tube = {toml_string(joint.tube)}"]
        lines.append(f"motion = {toml_string(joint.motion)}")
        lines += [
            f"{key} = {getattr(joint, key)!r}" for key in ("lower", "upper", "speed", "acceleration", "microstep")
        ]
    return _write(folder / ROBOT, "\n".join(lines) + "\n")


def _axis(axis: CoilAxis | None) -> str:
    """The line of the coil's axis, if there is one."""
    if axis is None or axis.refused:
        return ""
    return f"axis = {_row(axis.direction)}  # of the coil, there; single poses say so within {axis.spread:.2g} rad\n"


def _write(path: Path, text: str) -> Path:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from None
    return path


def _row(values: Sequence[float] | Array, digits: int = 9) -> str:
    return "[" + ", ".join(f"{float(value):#.{digits}g}" if value else "0.0" for value in values) + "]"
