"""Writes all files of a calibration's result."""

from pathlib import Path
from typing import Any, NamedTuple

from rich.table import Table
from rich.text import Text

from station.calibration import files, summary
from station.calibration.commission import LatencyResult
from station.calibration.files import REPORT_NUMBERS_FILE, VISITS_FILE
from station.calibration.plan import PlanSubject
from station.calibration.procedures import ForceResult, TrackerResult, TubesResult
from station.calibration.summary import Result
from station.control.calibrated_robot import RESIDUAL_FILE
from station.control.residual_file import write_residual
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
        """Title of the bench, and seed of its virtual lab, on one line."""
        return self.bench if self.seed is None else f"{self.bench}; seed {self.seed}"

    def __str__(self) -> str:
        """Origin of the numbers as one line, which the files contain."""
        return f"'calibrate {self.what}' of {self.when}, {self.where}; measurements in {VISITS_FILE}"


def write_all(
    folder: Path,
    result: Result,
    subject: PlanSubject,
    provenance: Provenance,
    assumed: TrackerMounting = GENERATOR_POSE,
    known: Path | None = None,
    assumed_latency: float = 0.0,
) -> dict[str, Any]:
    """Write the files that a run can use, the measurements, the numbers and the report; return the numbers.

    Args:
        folder: folder for the files, which is created if it does not exist.
        result: result of a procedure.
        subject: the robot with the parameters assumed before the calibration.
        provenance: origin of the numbers, which is written to every file.
        assumed: pose of the tracker assumed during the measurements.
        known: folder of the calibration in use; missing files are copied from it, so that the new folder is complete.
        assumed_latency: calibrated latency of the tracker in use during the measurements [s].

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
    elif isinstance(result, LatencyResult):
        written.append(files.write_latency(folder, assumed_latency + result.latency.latency, made))
    elif isinstance(result, TubesResult):
        tubes = result.calibration
        written += [
            files.write_registration(
                folder, subject.robot, tubes.frames, tubes.fit, tubes.errors, assumed, made, result.axis
            ),
            files.write_robot(folder, subject.file, tubes, made),
        ]
        if result.learned is not None and result.poses is not None:
            count = len(result.poses.joints)
            written.append(write_residual(folder / RESIDUAL_FILE, subject.robot, result.learned, count, made))
        if result.sensors is not None:
            written.append(files.write_sensors(folder, subject.robot, result.sensors, made))
    # Sensors and latency do not depend on the tubes, so the robot's file of an earlier calibration stays valid.
    if written and (known is None or not isinstance(result, ForceResult | LatencyResult)):
        written.append(files.write_described(folder, subject.described or subject.file))
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
    # Imported here because importing the figures' library takes a second, which would delay the station's start.
    from station.calibration.report import TITLES, page_parts
    from station.report.document import write_results

    parts = page_parts(provenance.what, result, subject, facts, simulated=provenance.simulated)
    written_numbers = {VISITS_FILE: summary.recorded(measurements), REPORT_NUMBERS_FILE: numbers}
    write_results(folder, f"{TITLES[provenance.what]}: calibration", parts, written_numbers)
    return numbers


def result_table(result: Result, subject: PlanSubject, provenance: Provenance) -> Table:
    """Return the table of results for the terminal."""
    from station.report.document import terminal_table

    title = Text(f"calibrate {provenance.what}\n{provenance.where}")
    return terminal_table(summary.FOUND_HEAD, summary.rows(result, subject), title=title)
