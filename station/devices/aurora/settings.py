"""Settings of one Aurora: tools, rates, timeouts, plausibility limits."""

from dataclasses import dataclass

from station.devices.aurora.protocol import BAUD_CODES, AuroraError


@dataclass(frozen=True)
class AuroraSettings:
    """Settings of one Aurora unit. Times are in seconds."""

    tool_serial: str = ""  #: serial number of the tip's coil, as PHINF reports it; empty: the tool with lowest handle
    target_serial: str = ""  #: serial number of a second coil, on the target; empty: no second coil
    baud: int = 115200  #: rate to which the driver switches; 9600 is too slow for 40 frames/s [bit/s]
    frame_rate: float = 40.0  #: frames that the unit measures per second [1/s]
    latency: float = 0.024  #: shortest time from measurement to arrival of the BX reply, 115200 baud (unconfirmed)
    always_tx: bool = False  #: request frames by TX (text) only, never by BX (binary)
    reply_timeout: float = 0.5  #: longest wait for the reply to most commands
    tool_timeout: float = 5.0  #: longest wait for the reply to PINIT, PENA and TSTART, which access the tool
    frame_timeout: float = 0.1  #: longest wait for the reply to BX and TX, plus the transmission time of the reply
    misses: int = 5  #: number of failed frame requests in a row after which the session restarts
    reset_wait: float = 3.0  #: longest wait for the text RESET after a break (unconfirmed)
    switch_wait: float = 0.1  #: wait after the reply to COMM until the new baud rate is used
    quiet: float = 0.1  #: wait after a failed reply, so that a late reply is not taken for the next command's reply
    retry_wait: float = 1.0  #: wait from a failure to the next attempt
    fastest: float = 500.0  #: largest speed of a coil; a faster motion counts as a jump [mm/s]
    jitter: float = 2.0  #: distance that a position may change in addition to the motion at `fastest` [mm]
    confirm_jump: int = 10  #: number of consistent frames after which a position beyond a jump is accepted
    measures_axis: bool = True  #: whether the tip's direction is measured by the coil's axis; False: axis is ignored
    coil_to_tip: float = 0.0  #: distance from the coil to the robot's tip along the coil's axis [mm]
    #: Port status bits that invalidate a measurement, besides the out-of-volume bits (bits from 8 on are unconfirmed).
    fault_bits: int = 0

    def __post_init__(self) -> None:
        if self.target_serial and self.target_serial == self.tool_serial:
            raise AuroraError(
                f"Aurora: tool {self.tool_serial} cannot be the tip's coil and the target's; name another"
            )
        if self.baud not in BAUD_CODES:
            raise AuroraError(f"Aurora: {self.baud} baud is not one of {', '.join(map(str, BAUD_CODES))}")
