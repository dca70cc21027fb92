"""Everything that a calibration leaves behind, written at once."""

import json
from pathlib import Path
from typing import Any, NamedTuple

from rich.table import Table
from rich.text import Text

from station.calibration import files, summary
from station.calibration.folder import NUMBERS, VISITS
from station.calibration.plan import Subject
from station.calibration.procedures import ForceResult, TrackerResult, TubesResult
from station.calibration.summary import Result
from station.config.strict import ConfigError
from station.devices.aurora.tracker import Registration
from station.lab.aurora.coil import MOUNT


class Provenance(NamedTuple):
    """Where the numbers come from."""

    what: str  #: procedure
    when: str  #: ISO 8601
    bench: str  #: the lab's title, or which devices
    seed: int | None  #: of a virtual lab; None: a real bench
    robot_s: float  #: from the first measurement to the last

    @property
    def simulated(self) -> bool:
        """Whether robot and devices were a virtual lab's."""
        return self.seed is not None

    @property
    def where(self) -> str:
        """The bench on one line."""
        return self.bench if self.seed is None else f"{self.bench}; seed {self.seed}"

    def __str__(self) -> str:
        """One line for the files."""
        return f"'calibrate {self.what}' of {self.when}, {self.where}; measurements in {VISITS}"


def write_all(
    folder: Path,
    result: Result,
    subject: Subject,
    provenance: Provenance,
    assumed: Registration = MOUNT,
    known: Path | None = None,
) -> dict[str, Any]:
    """The files for runs, the measurements, the numbers and the report; the numbers are the answer.

    Args:
        folder: made when it is not there.
        result: of a procedure.
        subject: as it was believed to be.
        provenance: goes into every file.
        assumed: where the tracker was believed to stand meanwhile.
        known: folder of the calibration in use; what was not found anew is copied from there, so that one folder
            says everything.

    Raises:
        ConfigError: the folder cannot be written to.
    """
    made = str(provenance)
    written: list[Path] = []
    if isinstance(result, TrackerResult):
        found = result.registration
        written.append(
            files.write_registration(
                folder, subject.robot, found.frames, found.fit, found.errors, assumed, made, result.axis
            )
        )
    elif isinstance(result, ForceResult):
        written.append(files.write_sensors(folder, subject.robot, result.calibration, made))
    elif isinstance(result, TubesResult):
        tubes = result.calibration
        written += [
            files.write_registration(
                folder, subject.robot, tubes.frames, tubes.fit, tubes.errors, assumed, made, result.axis
            ),
            files.write_sensors(folder, subject.robot, result.sensors, made),
            files.write_robot(folder, subject.file, tubes, made),
        ]
    if written and known is not None:
        written += files.carry_over(known, folder)
    measurements = [*getattr(result, "measurements", ()), *getattr(result, "check_measurements", ())]
    numbers: dict[str, Any] = {
        "procedure": provenance.what,
        "seed": provenance.seed,
        "lab": provenance.bench,
        "simulated": provenance.simulated,
        "made": provenance.when,
        "visits": len(measurements),
        "robot_s": round(provenance.robot_s, 3),
        "folder": str(folder),
        "files": [path.name for path in written],
        **summary.numbers(result, subject),
    }
    facts = [
        ("made", provenance.when),
        ("bench", provenance.where),
        ("robot", subject.robot.name),
        ("measurements", f"{len(measurements)}, {provenance.robot_s:.0f} s of robot time"),
        ("files", ", ".join(path.name for path in written) or "none"),
    ]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / VISITS).write_text(json.dumps(summary.recorded(measurements), indent=1) + "\n", encoding="utf-8")
        (folder / NUMBERS).write_text(json.dumps(numbers, indent=1) + "\n", encoding="utf-8")
        # Imported here: the figures' library takes a second, which the station's start must not.
        from station.calibration.report import write_report

        write_report(folder, provenance.what, result, subject, facts, simulated=provenance.simulated)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot write results there: {error.strerror}") from None
    return numbers


def result_table(result: Result, subject: Subject, provenance: Provenance) -> Table:
    """What was found, on the screen."""
    table = Table(title=Text(f"calibrate {provenance.what}\n{provenance.where}"), title_style="")
    table.add_column("")
    for column in ("before", "found", "+- (95 %)"):
        table.add_column(column, justify="right")
    for row in summary.rows(result, subject):
        table.add_row(*row)
    return table
