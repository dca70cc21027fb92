"""Bytes of every protocol that are flipped, lost, inserted, repeated, cut, exchanged or late: see `tests.fuzz.devices`.

Bytes without a checksum can also change a device, so a driver may ask a person to home a stage again.
"""

import pytest

from station.devices.registry import BUILT_IN_DRIVERS
from tests.fuzz.devices import PROTOCOLS, Found, fuzz
from tests.virtual.station.devices.test_every_stages import DIALECTS


def check(found: Found) -> None:
    """Check that a run has found no fault, and that the driver has not simply refused everything."""
    assert (found.wrong, found.exceptions, found.hangs) == (0, 0, 0)
    assert found.good > 100


@pytest.mark.parametrize("protocol", list(PROTOCOLS))
def test_damaged_bytes_give_no_wrong_value_and_the_driver_recovers(protocol):
    check(fuzz(protocol, 2000, seed=1))


def test_every_driver_of_a_line_or_network_is_tested_here():
    drivers = {
        name for table in BUILT_IN_DRIVERS.values() for driver in table for name in DIALECTS.get(driver, (driver,))
    }
    drivers -= {"nidaq"}  # its card is read by its maker's library, without a protocol
    assert drivers == {protocol.split()[0] for protocol in PROTOCOLS} - {"openigtlink", "imaginary"}
