"""Parts of the soak test: the measurement of growth, and the possible faults."""

import os

import pytest

from station.lab.faults import LabFault, check_faults
from tests.measure.soak import FAULT_CHANCES, Growth, resident_bytes


def test_growth_is_measured_by_its_slope() -> None:
    growing, steady = Growth(), Growth()
    for second in range(100):
        growing.add(second, 1e6 + 5e3 * second)
        steady.add(second, 5e7 if second > 10 else 1e6 * second)

    assert growing.slope == pytest.approx(5e3)
    assert steady.slope == pytest.approx(0.0, abs=1e-6)
    assert growing.size == 1e6 + 5e3 * 99


def test_resident_size_matches_the_systems_value() -> None:
    before = resident_bytes(os.getpid())
    assert before is not None
    block = bytearray(50_000_000)
    block[::4096] = b"x" * len(block[::4096])
    after = resident_bytes(os.getpid())
    assert after is not None
    assert after - before == pytest.approx(50e6, rel=0.2)
    assert resident_bytes(2**22 + 1) is None


def test_every_fault_of_the_soak_test_exists_in_the_lab(paper) -> None:
    check_faults([LabFault(kind=chance.kind, device=chance.device) for chance in FAULT_CHANCES], paper)
