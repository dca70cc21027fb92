"""Evidence that stages have stopped, for every behaviour of a custom driver's emergency stop."""

from collections.abc import Callable, Iterator

import pytest

from station.config.robots import RobotFile
from station.config.strict import ConfigError
from station.control.clock import REAL_TIME_CLOCK
from station.service.fallback_stop import FallbackStop, StopOutcome
from tests.harness import bad_stops
from tests.harness.bad_stops import MANNERS

NAME = "driver 'bad-stops'"
PRESS, NO_EVIDENCE = "press the emergency stop", "which is no evidence of a stop"
TEXTS = {
    "hangs": f"{NAME} has not stopped the stages; its attempt is still running after ",
    "raises": f"the stages could not be stopped (RuntimeError of {NAME}: no such port): {PRESS}",
    "raises SystemExit": f"the stages could not be stopped (SystemExit of {NAME}: 0): {PRESS}",
    "raises KeyboardInterrupt": f"the stages could not be stopped (KeyboardInterrupt of {NAME}): {PRESS}",
    "raises the unprintable": f"{NAME} could not stop the stages: {PRESS}",
    "raises NotStopped without a text": f"{NAME} has not stopped the stages: {PRESS}",
    "returns None": f"the emergency_stop of {NAME} returned NoneType instead of a text, {NO_EVIDENCE}",
    "returns an empty text": f"the emergency_stop of {NAME} returned an empty text, {NO_EVIDENCE}",
    "returns True": f"the emergency_stop of {NAME} returned bool instead of a text, {NO_EVIDENCE}",
    "returns bytes": f"the emergency_stop of {NAME} returned bytes instead of a text, {NO_EVIDENCE}",
    "lies": f"{NAME} reports: all stages have stopped",
}


@pytest.fixture(scope="module", autouse=True)
def installed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Install a Python package with the custom driver."""
    folder = tmp_path_factory.mktemp("site") / "bad_stops-1.0.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: bad-stops\nVersion: 1.0\n", encoding="utf-8")
    entries = "bad-stops = tests.harness.bad_stops:open_stages\nno-callable = tests.harness.bad_stops:no_callable"
    (folder / "entry_points.txt").write_text(f"[ctr_station.devices]\n{entries}\n", encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder.parent))
        yield


@pytest.fixture
def fallback_stop(paper: RobotFile) -> Iterator[Callable[[str], FallbackStop]]:
    made: list[FallbackStop] = []

    def fallback_stop(manner: str) -> FallbackStop:
        made.append(FallbackStop({"driver": "bad-stops", "manner": manner}, paper, REAL_TIME_CLOCK))
        return made[-1]

    yield fallback_stop
    for one in made:
        one.close(0.0)


@pytest.mark.parametrize("manner", [manner for manner in MANNERS if manner != "hangs"])
def test_only_a_returned_text_counts_as_evidence_that_the_stages_stop(
    fallback_stop: Callable[[str], FallbackStop], manner: str
) -> None:
    stop = fallback_stop(manner)
    for _ in range(2):  # try twice: the thread must survive the first attempt
        stopped = stop(30.0)
        assert stopped.text.startswith(TEXTS[manner])
        assert stopped.confirmed is (manner == "lies")
        assert stopped.confirmed or stopped.text.endswith(PRESS)


def test_wait_for_a_hanging_emergency_stop_is_bounded(fallback_stop: Callable[[str], FallbackStop]) -> None:
    stop = fallback_stop("hangs")
    try:
        stopped = stop(0.01)
        assert not stopped.confirmed
        assert stopped.text.startswith(TEXTS["hangs"])
        attempt = stop.begin()
        assert stop.begin() is attempt  # the attempt is shared, because a second one would wait for the same port
        stop.close(0.0)
        assert not attempt.done()
    finally:
        bad_stops.RELEASED.set()
    assert attempt.result(30.0) == StopOutcome(True, f"{NAME} reports: all stages have stopped at last")


def test_stop_after_close_succeeds_without_calling_the_driver(fallback_stop: Callable[[str], FallbackStop]) -> None:
    stop = fallback_stop("lies")
    stop.close(30.0)
    assert stop(0.0) == StopOutcome(True, "")


def test_emergency_stop_that_is_not_callable_is_refused_before_the_start(
    paper: RobotFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tests.harness.bad_stops.no_callable", lambda: None, raising=False)
    monkeypatch.setattr("tests.harness.bad_stops.no_callable.emergency_stop", "stop", raising=False)
    with pytest.raises(ConfigError, match="its emergency_stop is not a callable"):
        FallbackStop({"driver": "no-callable"}, paper, REAL_TIME_CLOCK)
