"""Every fault of a device has a sentence that starts with what has happened, never with an address."""

import pytest

from station.devices.ati import netft, nidaq
from station.devices.aurora import tracker
from station.devices.aurora.session import FrameQuality
from station.devices.interfaces import DeviceFault, Severity

TRACKER = {
    FrameQuality.GOOD: "the tracker's positions are late: there was no new one",
    FrameQuality.MISSING: "the tracker lost the coil",
    FrameQuality.OUT_OF_VOLUME: "the coil was outside the tracker's volume",
    FrameQuality.DISABLED: "the tracker's coil was disabled or unplugged",
    FrameQuality.JUMP: "the tracker's positions jumped, and no valid one arrived",
    FrameQuality.FAULT: "the tracker reported a fault of the coil or of itself",
    FrameQuality.SILENT: "the tracker was silent",
    FrameQuality.CONNECTING: "the tracker is still starting",
    FrameQuality.LOST: "the connection to the tracker is lost, and there was no position",
}
NETFT = {
    netft.WrenchQuality.GONE: "is not connected",
    netft.WrenchQuality.RESET: "has restarted, so its zero is unknown",
    netft.WrenchQuality.SATURATED: "is saturated: take the load off",
    netft.WrenchQuality.STATUS: "reports a fault",
    netft.WrenchQuality.RANGE: "measures more than its calibration allows: take the load off",
    netft.WrenchQuality.STALE: "was silent for too long",
}
CARDS = {
    nidaq.CardQuality.GONE: "is not connected: its card is lost",
    nidaq.CardQuality.SATURATED: "is saturated: take the load off",
    nidaq.CardQuality.STALE: "was silent for too long",
}


@pytest.mark.parametrize("quality", FrameQuality)
def test_every_quality_of_a_tracker_frame_has_its_sentence(quality: FrameQuality) -> None:
    assert tracker.HAPPENED[quality] == TRACKER[quality]


@pytest.mark.parametrize("quality", netft.WrenchQuality)
def test_every_unusable_reading_of_a_force_box_has_its_sentence(quality: netft.WrenchQuality) -> None:
    assert netft.HAPPENED.get(quality) == NETFT.get(quality)
    assert quality.is_usable == (quality not in NETFT)


@pytest.mark.parametrize("quality", nidaq.CardQuality)
def test_every_fault_of_a_card_has_its_sentence(quality: nidaq.CardQuality) -> None:
    assert nidaq.HAPPENED.get(quality) == CARDS.get(quality)


def test_a_fault_as_text_ends_with_its_details() -> None:
    fault = DeviceFault(Severity.HOLD, "the tracker lost the coil", "tracker on /dev/ttyUSB1: missing")

    assert str(fault) == "the tracker lost the coil (tracker on /dev/ttyUSB1: missing)"
    assert str(fault._replace(details="")) == "the tracker lost the coil"
