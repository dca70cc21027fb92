"""What calibrations have left in a folder: found by name, read back, and how each is put to use."""

import json
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from pydantic import BaseModel, ConfigDict

from core.errors import CtrError
from station.calibration.catalogue import OFFERS
from station.calibration.folder import NUMBERS, REPORT, VISITS
from station.config.strict import Strict
from station.control.known_calibration import REGISTRATION, ROBOT, SENSORS


class Numbers(BaseModel):
    """What the numbers of every calibration say, and what some of them say besides."""

    model_config = ConfigDict(strict=True, extra="ignore", allow_inf_nan=False)

    procedure: str
    made: str
    lab: str
    simulated: bool
    findings: list[str]
    found: list[dict[str, str]]
    visits: int
    robot_s: float
    latency_s: float | None = None
    signs: dict[str, float] = {}


class NoResultError(CtrError):
    """A calibration or a file of it that is not there."""


class Use(Strict):
    """How a result is put to use."""

    text: str
    line: str = ""
    """at the top of the station's file; empty when there is none to be put there"""
    options: str = ""
    """of ctr-station serve, for a station without a file"""


class Kept(NamedTuple):
    """One calibration."""

    name: str  #: of its folder
    numbers: Numbers  #: what `outcome` has written
    files: tuple[str, ...]  #: that can be had
    use: Use


class Results:
    """Calibrations in one folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def all(self) -> list[Kept]:
        """Every one, the newest first; what is damaged or only half written is left out."""
        found = [kept for path in self._folders() if (kept := _read(path)) is not None]
        return sorted(found, key=lambda kept: (kept.numbers.made, kept.name), reverse=True)

    def one(self, name: str) -> Kept:
        """The calibration of that name.

        Raises:
            NoResultError: there is none.
        """
        kept = _read(self._find(name))
        if kept is None:
            raise NoResultError(f"calibration '{name}' is damaged: no numbers in {NUMBERS}")
        return kept

    def file(self, name: str, file: str) -> Path:
        """A file of it.

        Raises:
            NoResultError: there is no such calibration, or no such file in it.
        """
        folder = self._find(name)
        if file not in _files(folder):
            raise NoResultError(f"calibration '{name}' has no file '{file}', but {', '.join(_files(folder))}")
        return folder / file

    def _find(self, name: str) -> Path:
        # Compared with what is there and never made into a path: a name cannot lead elsewhere.
        for path in self._folders():
            if path.name == name:
                return path
        raise NoResultError(f"'{name}' is not one of the calibrations in {self._folder}")

    def _folders(self) -> Iterator[Path]:
        if not self._folder.is_dir():
            return
        for path in self._folder.iterdir():
            if not path.is_symlink() and (path / NUMBERS).is_file():
                yield path


def _files(folder: Path) -> tuple[str, ...]:
    return tuple(name for name in (REGISTRATION, SENSORS, ROBOT, REPORT, NUMBERS, VISITS) if (folder / name).is_file())


def _read(folder: Path) -> Kept | None:
    try:
        folder.name.encode()  # what is not UTF-8 nobody can ask for
        # By the text: pydantic's reader knows neither half a surrogate pair nor a bottomless nest of brackets.
        numbers = Numbers.model_validate_json((folder / NUMBERS).read_bytes())
    except (OSError, ValueError):
        return None
    if numbers.procedure not in OFFERS:
        return None
    return Kept(folder.name, numbers, _files(folder), _use(folder.absolute(), numbers))


def _use(folder: Path, numbers: Numbers) -> Use:
    if any((folder / name).is_file() for name in (REGISTRATION, SENSORS, ROBOT)):
        text = (
            "Put this line at the top of the station's file, or start the station with this option: then it is in use."
        )
        return Use(
            text=text,
            line=f"calibration = {json.dumps(str(folder))}",
            options=f"--calibration {shlex.quote(str(folder))}",
        )
    if (late := numbers.latency_s) is not None:
        text = f"Add {1e3 * late:.1f} ms to `latency` under [devices.tracker] of the station's file."
        return Use(text=text)
    wrong = [name for name, sign in numbers.signs.items() if sign < 0.0]
    if wrong:
        turned = ", ".join(f"joints.{name}.backwards" for name in wrong)
        return Use(text=f"Turn round {turned} under [devices.stages] of the station's file, and do this again.")
    return Use(text="Nothing has to be changed: the axes run as described. 'tubes' finds the zero angles better.")
