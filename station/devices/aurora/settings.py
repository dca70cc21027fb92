"""Settings of one Aurora: tools, rates, timeouts, plausibility limits."""

from dataclasses import dataclass

from station.devices.aurora.protocol import BAUD_CODES, AuroraError


@dataclass(frozen=True)
class AuroraSettings:
    """Settings of one unit. Times in seconds."""

    tool_serial: str = ""  #: of the coil at the tip, as PHINF reports it; empty: the lowest handle
    target_serial: str = ""  #: of a second coil, on the target; empty: no second coil
    baud: int = 115200  #: rate to switch to; 9600 is too slow for 40 frames/s
    frame_rate: float = 40.0  #: [1/s]
    latency: float = 0.024  #: shortest time from measurement to arrival of its BX reply, 115200 baud (unconfirmed)
    always_tx: bool = False  #: never use BX
    reply_timeout: float = 0.5
    tool_timeout: float = 5.0  #: of PINIT, PENA and TSTART, which access the tool
    frame_timeout: float = 0.1  #: of BX and TX, plus their time on the line
    misses: int = 5  #: failed BX replies in a row until the session restarts
    reset_wait: float = 3.0  #: wait for RESET after a break (unconfirmed)
    switch_wait: float = 0.1  #: from COMM to the use of the new rate
    quiet: float = 0.1  #: after a failed reply, so that a late one cannot answer the next command
    retry_wait: float = 1.0  #: from a failure to the next attempt
    fastest: float = 500.0  #: largest speed of a coil; more is a jump [mm/s]
    jitter: float = 2.0  #: additional tolerance of a position [mm]
    confirm_jump: int = 10  #: consistent frames after a jump until it is accepted
    measures_axis: bool = True  #: the coil's axis is that of the tip; False: the axis is ignored
    coil_to_tip: float = 0.0  #: from the coil to the robot's tip along the coil's axis [mm]
    fault_bits: int = 0  #: port status bits that invalidate a measurement, plus those of the volume (8.. unconfirmed)

    def __post_init__(self) -> None:
        if self.target_serial and self.target_serial == self.tool_serial:
            raise AuroraError(
                f"Aurora: tool {self.tool_serial} cannot be the tip's coil and the target's; name another"
            )
        if self.baud not in BAUD_CODES:
            raise AuroraError(f"Aurora: {self.baud} baud is not one of {', '.join(map(str, BAUD_CODES))}")
