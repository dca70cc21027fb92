"""How to talk to one Aurora: which tool, at what rate, how long to wait, what to believe."""

from dataclasses import dataclass

from station.devices.aurora.protocol import BAUD_CODES, AuroraError


@dataclass(frozen=True)
class AuroraSettings:
    """How to talk to one unit. Times in seconds."""

    tool_serial: str = ""  #: of the coil at the tip, as PHINF tells it; empty: the lowest handle
    target_serial: str = ""  #: of a second coil, a target's; empty: there is none
    baud: int = 115200  #: to change to; 40 frames/s do not fit into 9600
    frame_rate: float = 40.0  #: [1/s]
    latency: float = 0.024  #: from a measurement to the soonest arrival of its BX reply at 115200 baud (unconfirmed)
    always_tx: bool = False  #: never BX
    reply_timeout: float = 0.5
    tool_timeout: float = 5.0  #: of PINIT, PENA and TSTART, which reach into the tool
    frame_timeout: float = 0.1  #: of BX and TX, plus their time on the line
    misses: int = 5  #: BX replies in a row that fail before everything begins anew
    reset_wait: float = 3.0  #: for RESET after a break (unconfirmed)
    switch_wait: float = 0.1  #: after COMM before the new rate is used
    quiet: float = 0.1  #: after a failed reply, so that a late one cannot answer the next command
    retry_wait: float = 1.0  #: before another attempt at what went wrong
    fastest: float = 500.0  #: a coil moving faster jumped [mm/s]
    jitter: float = 2.0  #: allowed on top [mm]
    confirm_jump: int = 10  #: frames that agree with one another after a jump before it is believed
    tells_axis: bool = True  #: the coil's axis is that of the tip; False: it is not looked at
    coil_to_tip: float = 0.0  #: from the coil to the robot's tip along the coil's axis [mm]
    fault_bits: int = 0  #: port status bits that spoil a measurement besides those of the volume (bits 8.. unconfirmed)

    def __post_init__(self) -> None:
        if self.target_serial and self.target_serial == self.tool_serial:
            raise AuroraError(
                f"Aurora: tool {self.tool_serial} cannot be the tip's coil and the target's; name another"
            )
        if self.baud not in BAUD_CODES:
            raise AuroraError(f"Aurora: {self.baud} baud is not one of {', '.join(map(str, BAUD_CODES))}")
