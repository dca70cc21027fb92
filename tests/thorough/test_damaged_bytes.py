"""A million damaged bytes of every protocol."""

import pytest

from tests.fuzz.devices import PROTOCOLS, fuzz
from tests.virtual.station.devices.test_damaged_bytes import check


@pytest.mark.parametrize("protocol", list(PROTOCOLS))
def test_a_million_damaged_bytes_give_no_wrong_value_and_the_driver_recovers(protocol):
    check(fuzz(protocol, 1_000_000, seed=11))
