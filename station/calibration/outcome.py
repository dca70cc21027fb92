"""Writes all files of a calibration's result."""

import json
from pathlib import Path
from typing import Any, NamedTuple

from rich.table import Table
from rich.text import Text

from station.calibration import files, summary
from station.calibration.files import REPORT_NUMBERS_FILE, VISITS_FILE
from station.calibration.plan import PlanSubject
from station.calibration.procedures import ForceResult, TrackerResult, TubesResult
from station.calibration.summary import Result
from station.config.strict import ConfigError
from station.devices.aurora.tracker import TrackerMounting
from station.lab.aurora_coil import GENERATOR_POSE


class Provenance(NamedTuple):
    """Origin of a calibration's numbers."""

    what: str  #: name of the procedure
    when: str  #: date and time, ISO 8601
    bench: str  #: title of the virtual lab, or names of the devices
    seed: int | None  #: seed of a virtual lab; None: a real bench
    robot_s: float  #: time from the first measurement to the last [s]
    simulated: bool  #: whether the devices report that they are simulated

    @property
    def where(self) -> str:
        """The bench on one line."""
        return self.bench if self.seed is None else f"{self.bench}; seed {self.seed}"

    def __str__(self) -> str:
        """One line for the files."""
        return f"'calibrate {self.what}' of {self.when}, {self.where}; measurements in {VISITS_FILE}"


def write_all(
    folder: Path,
    result: Result,
    subject: PlanSubject,
    provenance: Provenance,
    assumed: TrackerMounting = GENERATOR_POSE,
    known: Path | None = None,
) -> dict[str, Any]:
    """Write the files that a run can use, the measurements, the numbers and the report; return the numbers.

    Args:
        folder: folder for the files, which is created if it does not exist.
        result: result of a procedure.
        subject: the robot with the parameters assumed before the calibration.
        provenance: origin of the numbers, which is written to every file.
        assumed: pose of the tracker assumed during the measurements.
        known: folder of the calibration in use; missing files are copied from it, so that the new folder is complete.

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
            files.write_robot(folder, subject.file, tubes, made),
        ]
        if result.sensors is not None:
            written.append(files.write_sensors(folder, subject.robot, result.sensors, made))
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
        (folder / VISITS_FILE).write_text(json.dumps(summary.recorded(measurements), indent=1) + "\n", encoding="utf-8")
        (folder / REPORT_NUMBERS_FILE).write_text(json.dumps(numbers, indent=1) + "\n", encoding="utf-8")
        # Imported here because importing the figures' library takes a second, which would delay the station's start.
        from station.calibration.report import write_report

        write_report(folder, provenance.what, result, subject, facts, simulated=provenance.simulated)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot write results there: {error.strerror}") from None
    return numbers


def result_table(result: Result, subject: PlanSubject, provenance: Provenance) -> Table:
    """Return the table of results for the terminal."""
    table = Table(title=Text(f"calibrate {provenance.what}\n{provenance.where}"), title_style="")
    table.add_column("")
    for column in ("before", "found", "+- (95 %)"):
        table.add_column(column, justify="right")
    for row in summary.rows(result, subject):
        table.add_row(*row)
    return table
