"""The command `export`: convert a run's recordings to files for other programs."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.progress import TaskID


def add(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add the command `export` to the parser."""
    from station.cli.options import number_between

    export = commands.add_parser(
        "export", help="write a run's recordings as CSV, Parquet or MATLAB files, as a dataset, or its videos as MP4"
    )
    export.add_argument("run", metavar="RUN", help="folder of a run, its name in the data folder, or 'latest'")
    content = export.add_mutually_exclusive_group(required=True)
    content.add_argument("--format", choices=("csv", "parquet", "mat", "mp4"))
    content.add_argument(
        "--dataset", action="store_true", help="write a dataset of poses for learning, with its datasheet; RUN may"
        " also be a result of 'validate'",
    )  # fmt: skip
    export.add_argument("--licence", default="not stated", metavar="TEXT", help="licence of the dataset")
    export.add_argument("--camera", default="", metavar="NAME", help="only this camera's video, with --format mp4")
    export.add_argument("--out", type=Path, metavar="FILE|DIR", help="destination (default: the run's folder)")
    export.add_argument("--case", default="", metavar="NAME", help="only this case of the run")
    export.add_argument(
        "--fields", default="", metavar="NAME,…", help="only these fields, e.g. tip_measured,force (default: all)"
    )
    export.add_argument(
        "--rate", type=number_between(0.1, 500.0, "a rate", "1/s"), default=500.0, metavar="HZ",
        help="largest number of rows per second (default: 500)",
    )  # fmt: skip
    export.set_defaults(command=_export)


def _export(parsed: argparse.Namespace) -> int:
    from station.cli.options import progress_bar, recovered_data
    from station.recording.export import Choice, export_run
    from station.recording.history import resolve_run
    from station.recording.run_outcome import RecordingError

    runs = recovered_data(parsed)
    if parsed.dataset:
        from station.recording.dataset import ERRORS_FILE, export_dataset

        path = Path(parsed.run)
        folder = path if (path / ERRORS_FILE).is_file() else resolve_run(parsed.run, runs)
        sys.stdout.writelines(f"{file}\n" for file in export_dataset(folder, parsed.out, parsed.licence))
        return 0
    if parsed.format == "mp4":
        try:
            from station.camera.video import export_videos
        except ImportError:
            raise RecordingError("videos need the extra 'camera': pip install 'ctr-station[camera]'") from None
        videos = export_videos(resolve_run(parsed.run, runs), parsed.out, parsed.camera)
        sys.stdout.writelines(f"{file}\n" for file in videos)
        return 0
    with progress_bar() as bar:
        tasks: dict[str, TaskID] = {}

        def progress(case: str, part: float) -> None:
            if case not in tasks:
                tasks[case] = bar.add_task(f"export {case}", total=1.0)
            bar.update(tasks[case], completed=part)

        choice = Choice(tuple(name.strip() for name in parsed.fields.split(",") if name.strip()), parsed.rate)
        files = export_run(
            resolve_run(parsed.run, runs), parsed.format, parsed.out, progress, parsed.case, choice,
            lambda text: bar.console.print(f"ctr-station: {text}", markup=False, soft_wrap=True),
        )  # fmt: skip
    sys.stdout.writelines(f"{file}\n" for file in files)
    return 0
