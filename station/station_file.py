"""The station's own configuration: which robot, which lab, how it comes up."""

from collections.abc import Mapping
from pathlib import Path

from core.errors import CtrError
from station.config import ConfigError, Strict, check, preset, read_toml
from station.control_process import Bench
from station.experiments.experiment import ControllerFile, start_pose
from station.lab.config import LabConfig
from station.robots import load_robot


class StationFile(Strict):
    """What `ctr-station serve --config FILE` reads."""

    robot: str = "paper"
    """preset or file"""
    lab: str = "default"
    """virtual lab: preset or file"""
    seed: int = 0
    """of everything random in the virtual lab"""
    park: Mapping[str, float] = {"outer_rotation": 0.0, "inner_rotation": 1.5707963267948966, "inner_translation": -0.1}
    """joints at power-up [rad or m]"""
    controller: ControllerFile = ControllerFile(feedforward=True)
    """the loop's controller until a run brings its own"""
    fifo: bool = True
    """ask for real-time scheduling"""

    def bench(self) -> Bench:
        """What the control process needs, all of it checked.

        Raises:
            ConfigError: with file, key, value and what was expected.
        """
        robot = load_robot(self.robot)
        lab_path = preset("labs", self.lab)
        lab = check(LabConfig, read_toml(lab_path), str(lab_path))
        park = start_pose(self.park, robot)
        try:
            robot.limits().check(park)
            robot.robot().check_pose(park)
            self.controller.controller(robot)
        except CtrError as error:
            raise ConfigError(f"station configuration: {error}") from None
        return Bench(robot, lab, self.seed, tuple(park.tolist()), self.controller, self.fifo)


def load_station(path: Path | None) -> StationFile:
    """The station's configuration, or the defaults.

    Raises:
        ConfigError: with file, key, value and what was expected.
    """
    return StationFile() if path is None else check(StationFile, read_toml(path), str(path))
