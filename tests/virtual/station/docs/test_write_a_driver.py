"""The page `how-to/write-a-driver.md` names the requirement that each defect of its example breaks."""

import re
from functools import partial
from types import ModuleType

import pytest

from station.service.station_file import load_station
from tests.harness.root import ROOT
from tests.virtual.station.devices import test_driver_check
from tests.virtual.station.devices.test_driver_check import Box, Faulty, check_line_stages, failed

EXAMPLE = ROOT / "station" / "docs" / "examples" / "line_stages"
PAGE = (ROOT / "station" / "docs" / "pages" / "how-to" / "write-a-driver.md").read_text(encoding="utf-8")
SOURCE = (EXAMPLE / "line_stages.py").read_text(encoding="utf-8")


def test_station_file_of_the_page_is_valid(tmp_path):
    (text,) = re.findall(r"^```toml\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    (tmp_path / "bench.toml").write_text(text, encoding="utf-8")
    devices = load_station(tmp_path / "bench.toml").devices
    assert devices.stages == {"driver": "line-stages", "host": "192.168.1.20", "port": 4001}


class Unplugged(Faulty):
    """A box whose cable is pulled while the axes move."""

    def send(self) -> None:
        if self.now() > self._since and self.port.device.plugged:
            self.port.device.unplug()
        super().send()


#: What is omitted in the page's table: the text of the file, its replacement, and the box.
OMITTED = {
    "`np.clip` in `command`": ("np.clip(velocities, -self._speeds, self._speeds)", "velocities", Box),
    "`np.isfinite` in `command`": ("np.isfinite(velocities).all()", "True", Box),
    "`if self.ready` in `command`": ("if self.ready:", "if True:", Box),
    "the check for silence in `poll`": ("now - self._newest > SILENCE_S", "False", partial(Faulty, 1.1, "silent")),
    "`except` in `poll`": (
        "except (LinkError, ValueError) as error",
        "except ValueError as error",
        partial(Unplugged, 1.1, ""),
    ),
    "`open_stages.emergency_stop = ...`": ("open_stages.emergency_stop = emergency_stop", "", Box),
}


@pytest.mark.parametrize("omitted", list(OMITTED))
def test_part_of_the_driver_that_is_omitted_fails_the_requirement_that_the_page_names(omitted, monkeypatch):
    (named,) = re.findall(rf"^\| {re.escape(omitted)} \| ([\w ]*\w)", PAGE, re.MULTILINE)
    text, replacement, box = OMITTED[omitted]
    assert SOURCE.count(text) == 1
    module = ModuleType("line_stages")
    exec(SOURCE.replace(text, replacement), module.__dict__)
    monkeypatch.setattr(test_driver_check, "line_stages", module)
    stop = getattr(module.open_stages, "emergency_stop", None)
    with_clock = None if stop is None else lambda clock: stop(test_driver_check.OPTIONS, test_driver_check.PAPER, clock)
    assert failed(check_line_stages(box=box, driver=module.LineStages, stop=with_clock)) == {named}


def test_every_omission_of_the_page_is_tested():
    (table,) = re.findall(r"\| omitted \|.*?\n\n?$", PAGE + "\n", re.DOTALL)
    assert [row.split(" | ")[0].strip("| ") for row in table.strip().splitlines()[2:]] == list(OMITTED)
