"""What a soak is made of: how growth is told, and which faults may happen."""

import os

import pytest

from station.bench.growth import Growth, resident
from station.bench.soak import CHANCES
from station.lab.faults import LabFault, check_faults


def test_what_grows_is_told_by_its_slope() -> None:
    growing, steady = Growth(), Growth()
    for second in range(100):
        growing.add(second, 1e6 + 5e3 * second)
        steady.add(second, 5e7 if second > 10 else 1e6 * second)

    assert growing.slope == pytest.approx(5e3)
    assert steady.slope == pytest.approx(0.0, abs=1e-6)
    assert growing.size == 1e6 + 5e3 * 99


def test_the_size_of_a_process_is_that_of_the_system() -> None:
    before = resident(os.getpid())
    assert before is not None
    block = bytearray(50_000_000)
    block[::4096] = b"x" * len(block[::4096])
    after = resident(os.getpid())
    assert after is not None
    assert after - before == pytest.approx(50e6, rel=0.2)
    assert resident(2**22 + 1) is None


def test_every_fault_that_may_happen_is_one_of_the_labs(paper) -> None:
    check_faults([LabFault(kind=chance.kind, device=chance.device) for chance in CHANCES], paper)
