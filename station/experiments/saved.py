"""Save motions that an operator has created on a running station as ordinary experiment files."""

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from pydantic import Field

from core.errors import CtrError
from station.config.controllers import ControllerFile
from station.config.loads import Load, NoLoad
from station.config.motions import TipMotion
from station.config.strict import (
    EXPERIMENTS_VARIABLE,
    FORMAT,
    PRESETS,
    ConfigError,
    Strict,
    preset_names,
    toml_lines,
    use_experiments,
)
from station.experiments.experiment import load_experiment

#: Name of the default folder of saved experiments, inside the folder of the runs.
EXPERIMENTS_FOLDER = "experiments"


class SavedError(CtrError):
    """A motion was not saved or cannot be opened; the message gives the reason."""


class SavedAlreadyError(SavedError):
    """An experiment with the requested name exists already."""


class FreeMotion(Strict):
    """A free motion with everything that is needed to repeat it."""

    title: Annotated[str, Field(min_length=1, max_length=200)]
    start: Mapping[str, float]
    """joint positions at the start [rad or m]"""
    duration: Annotated[float, Field(gt=0.0, le=86400.0)]
    """duration of the motion [s]"""
    trajectory: Annotated[TipMotion, Field(discriminator="kind")]
    controller: ControllerFile
    load: Load = NoLoad()


def use_saved(data: Path) -> None:
    """Select the folder of experiments in the data folder, unless the user has selected another folder."""
    if not os.environ.get(EXPERIMENTS_VARIABLE) and (data / EXPERIMENTS_FOLDER).is_dir():
        use_experiments(data / EXPERIMENTS_FOLDER)


def save(motion: FreeMotion, name: str, data: Path, about: Mapping[str, str], *, replace: bool) -> Path:
    """Save a motion in the folder of experiments that is in use, or else in the folder of the runs.

    Args:
        motion: motion to save; the written file is read back and checked on the model first.
        name: name of the new experiment.
        data: folder of the runs.
        about: names of robot, lab and calibration for the file.
        replace: whether to overwrite an experiment of that name.

    Returns:
        Path of the file.

    Raises:
        SavedAlreadyError: an experiment of that name exists, and `replace` is False.
        SavedError: the name is that of an experiment that comes with the station, or the folder cannot be written.
        ConfigError: the motion cannot be carried out, with the reason.
    """
    if (PRESETS / "experiments" / f"{name}.toml").exists():
        raise SavedError(f"name = '{name}' is used by a preset of the station; choose another name")
    own = os.environ.get(EXPERIMENTS_VARIABLE)
    folder = Path(own) if own else data / EXPERIMENTS_FOLDER
    path = folder / f"{name}.toml"
    if path.exists() and not replace:
        raise SavedAlreadyError(f"name = '{name}': {path} exists already; choose another name, or set replace")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # The file stays in a temporary folder until it has been checked, so other processes never read an invalid one.
        with tempfile.TemporaryDirectory(dir=folder, prefix=".") as aside:
            written = Path(aside, path.name)
            written.write_text(_text(motion, about), encoding="utf-8")
            try:
                load_experiment(str(written))
            except ConfigError as error:
                raise ConfigError(f"'{name}' is not saved: {str(error).replace(str(written), path.name)}") from None
            written.replace(path)
    except OSError as error:
        raise SavedError(f"{path}: cannot be written: {error.strerror}") from None
    use_experiments(folder)
    return path


def saved_motion(name: str) -> FreeMotion:
    """Return the first case of an experiment as a free motion.

    Raises:
        SavedError: there is no experiment of that name, or its kind of motion is not available as a free motion.
        ConfigError: its file is not a valid experiment.
    """
    if name not in preset_names("experiments"):
        raise SavedError(f"name = '{name}' is not one of the experiments: {', '.join(preset_names('experiments'))}")
    experiment = load_experiment(name)
    file = experiment.cases[0].file
    if not isinstance(file.trajectory, TipMotion):
        raise SavedError(f"'{name}' has a motion of kind '{file.trajectory.kind}', which only files can have")
    return FreeMotion(
        title=file.title, start=file.start, duration=file.duration, trajectory=file.trajectory,
        controller=file.controller, load=file.load,
    )  # fmt: skip


def _text(motion: FreeMotion, about: Mapping[str, str]) -> str:
    """Return the TOML text of the experiment's file for a motion."""
    table = {
        "format": FORMAT,
        "title": motion.title,
        **about,
        "start": motion.start,
        "duration": motion.duration,
        "settling": 0.0,
    }
    parts = {"trajectory": motion.trajectory, "load": motion.load, "controller": motion.controller}
    lines = toml_lines(table)
    for key, part in parts.items():
        lines += ["", f"[{key}]", *toml_lines(part.model_dump(mode="json"))]
    return "\n".join(lines) + "\n"
