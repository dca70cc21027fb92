"""Motions that were made on a running station, kept as experiment files like any other."""

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from pydantic import Field

from core.errors import CtrError
from station.config.controllers import ControllerFile
from station.config.motions import TipMotion
from station.config.strict import FORMAT, OWN_EXPERIMENTS, PRESETS, ConfigError, Strict, preset_names, use_experiments
from station.config.toml_text import toml_lines
from station.experiments.experiment import load_experiment
from station.lab.loads import Load, NoLoad
from station.recording.tracking_errors import settling_time

#: Folder beside the runs, where the station's file names no other.
FOLDER = "experiments"


class SavedError(CtrError):
    """A motion that is not saved; the text says why."""


class SavedAlreadyError(SavedError):
    """One of that name is there."""


class FreeMotion(Strict):
    """A free motion with what it needs to be carried out again."""

    title: Annotated[str, Field(min_length=1, max_length=200)]
    start: Mapping[str, float]
    """where it begins [rad or m]"""
    duration: Annotated[float, Field(gt=0.0, le=86400.0)]
    """[s]"""
    trajectory: Annotated[TipMotion, Field(discriminator="kind")]
    controller: ControllerFile
    load: Load = NoLoad()


def use_saved(data: Path) -> None:
    """Find what was saved in the folder of `data` by its name, unless another folder of experiments is in use."""
    if not os.environ.get(OWN_EXPERIMENTS) and (data / FOLDER).is_dir():
        use_experiments(data / FOLDER)


def save(motion: FreeMotion, name: str, data: Path, about: Mapping[str, str], *, replace: bool) -> Path:
    """Keep a motion in the folder of experiments that is in use, else in one beside the runs.

    Args:
        motion: to be kept; it is read back and tried on the model first.
        name: of the experiment from then on.
        data: folder of the runs.
        about: robot, lab and calibration that it is for, as the file names them.
        replace: one of that name.

    Returns:
        The file.

    Raises:
        SavedAlreadyError: there is one of that name, and `replace` is not said.
        SavedError: the name is that of an experiment that comes with the station, or the folder cannot be written.
        ConfigError: the motion cannot be carried out, with the reason.
    """
    if (PRESETS / "experiments" / f"{name}.toml").exists():
        raise SavedError(f"name = '{name}' is that of an experiment that comes with the station; choose another name")
    own = os.environ.get(OWN_EXPERIMENTS)
    folder = Path(own) if own else data / FOLDER
    path = folder / f"{name}.toml"
    if path.exists() and not replace:
        raise SavedAlreadyError(f"name = '{name}': {path} is there already; choose another name, or say replace")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # In a folder of its own until all of it has been looked at: nobody finds half a file.
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
    """The first case of an experiment as a free motion.

    Raises:
        SavedError: there is none of that name, or its motion is none that can be had freely.
        ConfigError: its file is no experiment.
    """
    if name not in preset_names("experiments"):
        raise SavedError(f"name = '{name}' is not one of the experiments: {', '.join(preset_names('experiments'))}")
    experiment = load_experiment(name)
    file = experiment.cases[0].file
    if not isinstance(file.trajectory, TipMotion):
        raise SavedError(f"'{name}' has a motion of kind '{file.trajectory.kind}', which is for files only")
    return FreeMotion(
        title=file.title, start=file.start, duration=file.duration, trajectory=file.trajectory,
        controller=file.controller, load=file.load,
    )  # fmt: skip


def _text(motion: FreeMotion, about: Mapping[str, str]) -> str:
    """The experiment's file."""
    table = {
        "format": FORMAT,
        "title": motion.title,
        **about,
        "start": motion.start,
        "duration": motion.duration,
        "settling": settling_time(motion.duration),
    }
    parts = {"trajectory": motion.trajectory, "load": motion.load, "controller": motion.controller}
    lines = toml_lines(table)
    for key, part in parts.items():
        lines += ["", f"[{key}]", *toml_lines(part.model_dump(mode="json"))]
    return "\n".join(lines) + "\n"
