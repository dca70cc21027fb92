"""`residual.toml`: the learned residual of the model, with its origin.

`ctr-station calibrate residual` writes it next to the tubes and frames to which it belongs; a calibration with this
file corrects the controller's model.
"""

from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from core.control.tip_residual import MAX_SUPPORT, TipResidual, inputs_of
from core.robot.robot import Array, Robot
from station.config.strict import ConfigError, Format, Row, Strict, check, read_toml, toml_lines

# Plausible ranges of the numbers; a number beyond its range comes from a failed fit or a damaged file.
Table = Annotated[tuple[Annotated[tuple[Annotated[float, Field(ge=-1e6, le=1e6)], ...], Row], ...], Row]


class ResidualFile(Strict):
    """`residual.toml`: learned residual of the model's tip."""

    format: Format = 1
    """format of this file"""
    robot: str
    """name of the robot whose model it corrects"""
    made: str
    """date and source of the data"""
    version: str
    """version of ctr-station that fitted it"""
    poses: Annotated[int, Field(ge=1, le=1_000_000)]
    """number of poses to which the residual was fitted"""
    strength: Annotated[float, Field(gt=0.0, le=1.0)]
    """factor of the prediction that fits held-out trajectories best"""
    tolerance: Annotated[float, Field(gt=0.0, le=0.1)]
    """95 % quantile of the errors at held-out trajectories; the residual is switched off when it makes the tip's error
    larger than the model's by more than this [m]"""
    rates: Annotated[tuple[Annotated[float, Field(ge=0.0, le=1e6)], ...], Row]
    """inverse length scale of each input: cosine and sine of each rotation, translations, directions of the last
    motions, force; 0: the input has no effect"""
    support: Table
    """inputs of each support point"""
    weights: Table
    """weights of the kernel values of the support points [m]"""
    explained: Table
    """matrix of the explained share of the variance"""

    @model_validator(mode="after")
    def _shapes(self) -> "ResidualFile":
        m, d = len(self.support), len(self.rates)
        if not 1 <= m <= MAX_SUPPORT:
            raise ValueError(f"support has {m} points; expected 1 ... {MAX_SUPPORT}")
        for name, table, rows, columns in (
            ("support", self.support, m, d), ("weights", self.weights, m, 3), ("explained", self.explained, m, m),
        ):  # fmt: skip
            if len(table) != rows or any(len(row) != columns for row in table):
                raise ValueError(f"{name} is not a table of {rows} rows with {columns} numbers")
        return self


def read_residual(path: Path, robot: Robot) -> TipResidual:
    """Return the residual in a file.

    Raises:
        ConfigError: the file is invalid, or for another robot.
    """
    file, inputs = check(ResidualFile, read_toml(path), str(path)), inputs_of(robot)
    if file.robot != robot.name or len(file.rates) != len(inputs.table):
        raise ConfigError(
            f"{path}: made for robot '{file.robot}' with {len(file.rates)} inputs, not for '{robot.name}'"
        )
    with np.errstate(divide="ignore"):
        scales = 1.0 / np.array(file.rates)
    base = np.ascontiguousarray(robot.base.rotation)
    support, weights, explained = (np.array(each) for each in (file.support, file.weights, file.explained))
    return TipResidual(inputs, base, scales, support, weights, explained, file.strength, file.tolerance)


def write_residual(path: Path, robot: Robot, found: TipResidual, poses: int, made: str) -> Path:
    """Write a residual that was fitted to a number of poses.

    Raises:
        ConfigError: the file cannot be written.
    """
    file = ResidualFile(
        robot=robot.name, made=made, version=version("ctr-station"), poses=poses, strength=found.strength,
        tolerance=found.tolerance, rates=tuple((1.0 / found.scales).tolist()), support=_rows(found.support),
        weights=_rows(found.weights), explained=_rows(found.explained),
    )  # fmt: skip
    text = "# Learned residual of the model's tip; see `core/control/tip_residual.py`.\n"
    try:
        path.write_text(text + "\n".join(toml_lines(file.model_dump())) + "\n", encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from None
    return path


def _rows(table: Array) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in table.tolist())
