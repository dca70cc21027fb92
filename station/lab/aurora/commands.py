"""Parser for the commands of a simulated Aurora, in both forms, with its refusals."""

from station.devices.aurora.protocol import BAUD_CODES, crc16

MAX_COMMAND_BYTES = 512


class AuroraRefusal(Exception):
    """A command that the simulated tracker refuses with an ERROR reply; it is not an error of this program."""

    def __init__(self, code: int) -> None:
        self.code = code


def parse_command(line: bytes) -> tuple[str, str]:
    """Return name and parameters of `CMD:params` + CRC or `CMD params`."""
    if len(line) > MAX_COMMAND_BYTES:
        raise AuroraRefusal(0x02)
    try:
        text = line.decode("ascii")
    except UnicodeDecodeError:
        raise AuroraRefusal(0x04) from None
    name, separator, parameters = text.partition(":")
    if separator and " " not in name:
        if len(parameters) < 4:
            raise AuroraRefusal(0x03)
        if parameters[-4:].upper() != f"{crc16(line[:-4]):04X}":
            raise AuroraRefusal(0x04)
        return name.upper(), parameters[:-4]
    name, separator, parameters = text.partition(" ")
    if not separator:
        raise AuroraRefusal(0x01)
    return name.upper(), parameters


def number(digits: str, count: int) -> int:
    """Return the number of exactly `count` hexadecimal digits."""
    if len(digits) != count:
        raise AuroraRefusal(0x03 if len(digits) < count else 0x02)
    if not all(digit in "0123456789abcdefABCDEF" for digit in digits):
        raise AuroraRefusal(0x23)
    return int(digits, 16)


def parse_rate(parameters: str) -> tuple[int, int]:
    """Return baud and bits of a character from COMM's five digits."""
    if len(parameters) != 5:
        raise AuroraRefusal(0x03 if len(parameters) < 5 else 0x02)
    bauds = {code: baud for baud, code in BAUD_CODES.items()}
    rate, data, parity, stop, handshake = parameters.upper()
    if rate not in bauds or data not in "01" or parity not in "012" or stop not in "01" or handshake not in "01":
        raise AuroraRefusal(0x06)
    return bauds[rate], 1 + 8 - int(data) + (parity != "0") + 1 + int(stop)
