"""Many runs of kinds that the default tests try once: forces next to a wall, failed devices, faulty meshes."""

import pytest

from tests.harness.ideal_station import BENCHES, Kind
from tests.tools.region_streams import random_stream
from tests.virtual.station.control.test_force_bound import attack
from tests.virtual.station.control.test_keep_out_failures import FAILURES, check_failure


@pytest.mark.parametrize("seed", range(1, 8))
@pytest.mark.parametrize("without", BENCHES)
def test_random_orders_neither_exceed_the_largest_force_nor_hide_a_contact(
    without: tuple[Kind, ...], seed: int
) -> None:
    found = attack(without, seed)
    assert min(found[key] for key in ("bound", "tare", "start")) > 0.0, found


@pytest.mark.parametrize("failure", list(FAILURES))
def test_tubes_come_no_nearer_to_a_region_after(failure: str) -> None:
    check_failure(failure)


@pytest.mark.parametrize("seed", [7, 11, 14])
def test_the_true_tubes_keep_the_margin_of_an_accepted_mesh(seed: int) -> None:
    """Without the region, the tubes would enter the mesh with the seeds 7 and 11."""
    found = random_stream(seed, 2.5)
    assert found is not None
    _, run, free = found
    assert run.clearance > -0.1e-3
    assert seed == 14 or free.clearance < -2e-3
