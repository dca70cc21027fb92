"""An experiment in a package: its cases run in virtual time, and the errors after the step are printed."""

from collections.abc import Iterator
from pathlib import Path

from station.control.clock import VirtualClock
from station.experiments.experiment import load_experiment
from station.experiments.results import summarise
from station.experiments.runner import run_case

EXPERIMENT = Path(__file__).with_suffix(".toml")


def errors(seed: int = 0) -> Iterator[tuple[str, float]]:
    """Yield the name of each case and its largest true error [mm] after 3 s."""
    for case in load_experiment(str(EXPERIMENT)).cases:
        recording = run_case(case, seed, VirtualClock(), progress=lambda part: None)
        yield case.name, max(summarise(recording)["true_max_abs_error_mm"])


def main() -> None:
    """Print the error of every case."""
    for name, error in errors():
        print(f"{name}: {error:.2f} mm after 3 s")


if __name__ == "__main__":
    main()
