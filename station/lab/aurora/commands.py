"""How a simulated Aurora reads a command, in both forms, and what it refuses."""

from station.devices.aurora.protocol import BAUD_CODES, crc16

LONGEST_COMMAND = 512


class Refused(Exception):
    """The unit's answer is ERROR; not an error of this program."""

    def __init__(self, code: int) -> None:
        self.code = code


def parse_command(line: bytes) -> tuple[str, str]:
    """Name and parameters of `CMD:params` + CRC or `CMD params`."""
    if len(line) > LONGEST_COMMAND:
        raise Refused(0x02)
    try:
        text = line.decode("ascii")
    except UnicodeDecodeError:
        raise Refused(0x04) from None
    name, separator, parameters = text.partition(":")
    if separator and " " not in name:
        if len(parameters) < 4:
            raise Refused(0x03)
        if parameters[-4:].upper() != f"{crc16(line[:-4]):04X}":
            raise Refused(0x04)
        return name.upper(), parameters[:-4]
    name, separator, parameters = text.partition(" ")
    if not separator:
        raise Refused(0x01)
    return name.upper(), parameters


def number(digits: str, count: int) -> int:
    """The number that exactly `count` hex digits mean."""
    if len(digits) != count:
        raise Refused(0x03 if len(digits) < count else 0x02)
    if not all(digit in "0123456789abcdefABCDEF" for digit in digits):
        raise Refused(0x23)
    return int(digits, 16)


def parse_rate(parameters: str) -> tuple[int, int]:
    """Baud and bits of a character from COMM's five digits."""
    if len(parameters) != 5:
        raise Refused(0x03 if len(parameters) < 5 else 0x02)
    bauds = {code: baud for baud, code in BAUD_CODES.items()}
    rate, data, parity, stop, handshake = parameters.upper()
    if rate not in bauds or data not in "01" or parity not in "012" or stop not in "01" or handshake not in "01":
        raise Refused(0x06)
    return bauds[rate], 1 + 8 - int(data) + (parity != "0") + 1 + int(stop)
