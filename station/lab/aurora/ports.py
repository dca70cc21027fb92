"""The port handles of a simulated Aurora tracker: their states and the commands for them.

The commands are PHSR, PHINF, PINIT, PENA, PDIS and PHF.
"""

from dataclasses import dataclass

from station.devices.aurora.replies import ENABLED, IN_PORT, INITIALISED, PORT_OCCUPIED
from station.lab.aurora.commands import AuroraRefusal, number


@dataclass
class ToolPort:
    """A port handle: the number that the tracker gives to a plugged-in tool."""

    handle: int
    serial: str  #: serial number of the tool
    target: bool = False  #: whether the tool is the target's coil instead of the tip's
    initialised: bool = False
    enabled: bool = False
    gone: bool = False  #: whether the tool is unplugged, but its handle not yet freed

    @property
    def status(self) -> int:
        """Status bits of the port handle."""
        return (0 if self.gone else IN_PORT) | (INITIALISED * self.initialised) | (ENABLED * self.enabled)


class PortHandles:
    """All port handles of a tracker with the tip's coil and, optionally, the coil of a moving target."""

    def __init__(self, serial: str, target: str = "") -> None:
        self._serial, self._target = serial, target
        self.ports = self._plugged()
        self.changed = 0  #: system status bits, cleared when the host reads the ports

    def unplug(self) -> None:
        """Pull the plug of the tip's coil."""
        self._tip.gone = True
        self.changed |= 0x80

    def plug(self) -> None:
        """Plug the tip's coil in again; it gets another handle."""
        self.ports.append(ToolPort((max(port.handle for port in self.ports) + 1) & 0xFF, self._serial))
        self.changed |= PORT_OCCUPIED

    def restart(self) -> None:
        """Reset all handles to the state after power-up."""
        tip = self._tip
        self.ports = self._plugged()
        if tip.gone:
            self.ports[0] = tip

    @property
    def _tip(self) -> ToolPort:
        """The newest handle of the tip's coil."""
        return next(port for port in reversed(self.ports) if not port.target)

    def _plugged(self) -> list[ToolPort]:
        """Return the handles that plugged-in tools get at power-up."""
        return [ToolPort(0x0A, self._serial), *([ToolPort(0x0B, self._target, target=True)] if self._target else [])]

    def forget(self) -> None:
        """Reset all tools to not initialised and not enabled, as INIT does."""
        for port in self.ports:
            port.initialised = port.enabled = False

    def enabled(self) -> list[ToolPort]:
        """Return the handles of the enabled tools, which the frames contain."""
        return [port for port in self.ports if port.enabled]

    def search(self, parameters: str) -> str:
        """Return the answer to PHSR, which clears the reported changes."""
        tests = {
            0: lambda port: True,  # noqa: ARG005
            1: lambda port: port.gone,
            2: lambda port: not port.gone and not port.initialised,
            3: lambda port: not port.gone and port.initialised and not port.enabled,
            4: lambda port: not port.gone and port.enabled,
        }
        which = number(parameters or "00", 2)
        if which not in tests:
            raise AuroraRefusal(0x23)
        self.changed = 0
        found = [port for port in self.ports if tests[which](port)]
        return f"{len(found):02X}" + "".join(f"{port.handle:02X}{port.status:03X}" for port in found)

    def information(self, parameters: str) -> str:
        """Return the answer to PHINF."""
        port = self._port(parameters[:2])
        options = number(parameters[2:] or "0001", 4)
        if port.gone:
            return "UNOCCUPIED"
        fields = {
            0x0001: f"{'02000000':8}{'simulated':12}{'001':3}{port.serial:8}{port.status:02X}",
            0x0002: "00000000",
            0x0004: f"{'CTR-TARGET-5DOF' if port.target else 'CTR-TIP-5DOF':20}",
            0x0008: "00",
            0x0010: "00",
            0x0020: "00000000000001",
            0x0040: "00",
        }
        return "".join(text for bit, text in fields.items() if options & bit)

    def change(self, name: str, parameters: str, tracking: bool) -> None:
        """Execute PINIT, PENA, PDIS or PHF."""
        port = self._port(parameters[:2])
        if tracking:
            raise AuroraRefusal(0x0C)
        priority = parameters[2:]
        if name == "PENA" and (len(priority) != 1 or priority not in "SDB"):
            raise AuroraRefusal(0x09)
        if name != "PENA" and priority:
            raise AuroraRefusal(0x02)
        if name == "PHF":
            port.initialised = port.enabled = False
            if port.gone and len(self.ports) > 1:
                self.ports.remove(port)
        elif port.gone:
            raise AuroraRefusal(0x0D)
        elif name == "PINIT":
            port.initialised = True
        elif not port.initialised:
            raise AuroraRefusal(0x0E)
        else:
            port.enabled = name == "PENA"

    def _port(self, digits: str) -> ToolPort:
        handle = number(digits, 2)
        for port in self.ports:
            if port.handle == handle:
                return port
        raise AuroraRefusal(0x08)
