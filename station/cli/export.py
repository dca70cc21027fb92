"""The command `export`: convert a run's recordings to files for other programs."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.progress import TaskID


def add(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add the command `export` to the parser."""
    export = commands.add_parser(
        "export", help="write a run's recordings as CSV, Parquet or MATLAB files, or its videos as MP4"
    )
    export.add_argument("run", metavar="RUN", help="folder of a run, its name in the data folder, or 'latest'")
    export.add_argument("--format", choices=("csv", "parquet", "mat", "mp4"), required=True)
    export.add_argument("--camera", default="", metavar="NAME", help="only this camera's video, with --format mp4")
    export.add_argument("--out", type=Path, metavar="FILE|DIR", help="destination of the files (the run's folder)")
    export.add_argument("--case", default="", metavar="NAME", help="only this case of the run")
    export.set_defaults(command=_export)


def _export(parsed: argparse.Namespace) -> int:
    from station.cli.options import progress_bar, recovered_data
    from station.recording.export import export_run
    from station.recording.history import resolve_run
    from station.recording.run_outcome import RecordingError

    runs = recovered_data(parsed)
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

        files = export_run(resolve_run(parsed.run, runs), parsed.format, parsed.out, progress, parsed.case)
    sys.stdout.writelines(f"{file}\n" for file in files)
    return 0
