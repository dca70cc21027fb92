"""Every fault of a device has a sentence that starts with the fault, never with an address."""

import math

import pytest

from station.devices.interfaces import DeviceFault, Severity
from station.devices.kernel.quality import HAPPENED, Quality, Sampled, quoted, sample_fault


def test_every_quality_that_ends_a_motion_has_its_own_sentence() -> None:
    assert set(HAPPENED) == {quality for quality in Quality if not quality.is_usable}
    assert len(set(HAPPENED.values())) == len(HAPPENED)


@pytest.mark.parametrize(
    ("quality", "age", "text"),
    [
        (Quality.MISSING, 0.254, "the tracker lost the coil for 0.25 s"),
        (Quality.MISSING, math.inf, "the tracker lost the coil"),
        (Quality.STALE | Quality.SATURATED, 1.0, "the tracker is saturated for 1.00 s: take the load off"),
        (Quality.GOOD, 0.2, "the tracker sent no new usable sample for 0.20 s"),
    ],
)
def test_text_names_the_most_specific_reason_and_its_duration(quality: Quality, age: float, text: str) -> None:
    assert sample_fault([Sampled("the tracker", quality, age)]).text == text


def test_fault_is_a_hold_after_its_time_and_at_once_without_a_connection() -> None:
    silent, lost = (Sampled("it", quality, 0.1) for quality in (Quality.SILENT, Quality.LOST))
    assert sample_fault([silent], 0.2).severity is Severity.WARN
    assert sample_fault([silent], 0.05).severity is Severity.HOLD
    assert sample_fault([lost], 0.2).severity is Severity.HOLD


def test_text_of_the_driver_replaces_that_of_the_quality() -> None:
    device = Sampled("it", Quality.WRONG_RATE, 0.5, "on port 1", "sends 3/s{since}: set {'rate'}")
    assert sample_fault([device, device]) == DeviceFault(
        Severity.HOLD,
        "it sends 3/s for 0.50 s: set {'rate'}; it sends 3/s for 0.50 s: set {'rate'}",
        "on port 1; on port 1",
    )


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (b"", "''"),
        (b"OKAY\r", "'OKAY\\r'"),
        (b"\x00\xff", "00 ff"),
        (b"0123456789abc", "'0123456789ab' ... (13 bytes)"),
    ],
)
def test_quoted_bytes_are_text_or_hexadecimal(data: bytes, text: str) -> None:
    assert quoted(data) == text


def test_fault_as_text_ends_with_its_details() -> None:
    fault = DeviceFault(Severity.HOLD, "the tracker lost the coil", "tracker on /dev/ttyUSB1: missing")

    assert str(fault) == "the tracker lost the coil (tracker on /dev/ttyUSB1: missing)"
    assert str(fault._replace(details="")) == "the tracker lost the coil"
