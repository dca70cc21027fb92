"""Parser of an ATI Net F/T's configuration page, `netftapi2.xml`: force and torque per count.

The parser is strict, because a wrong scale gives a wrong force. The page must be well-formed XML without a DOCTYPE.
Each of the five required elements must occur once and contain only text: positive finite numbers and known unit names.
The calibration's serial number and ranges are optional. The parser ignores all other elements.
"""

import math
import re
from dataclasses import dataclass
from xml.parsers import expat

from core.errors import CtrError

#: Force units of a page [N].
FORCE_UNITS = {
    "N": 1.0,
    "kN": 1e3,
    "lbf": 4.4482216152605,
    "klbf": 4448.2216152605,
    "kgf": 9.80665,
}
#: Torque units of a page [N m].
TORQUE_UNITS = {
    "N-m": 1.0,
    "Nm": 1.0,
    "N-mm": 1e-3,
    "Nmm": 1e-3,
    "kN-m": 1e3,
    "lbf-in": 0.1129848290276167,
    "lbf-ft": 1.3558179483314004,
    "kgf-cm": 0.0980665,
    "kg-cm": 0.0980665,
}
REQUIRED_FIELDS = ("prodname", "cfgcpf", "cfgcpt", "scfgfu", "scfgtu")
OPTIONAL_FIELDS = ("cfgcalsn", "cfgmr")
MAX_PAGE_BYTES = 1 << 18  #: largest page that is read [bytes]; a real page has a few thousand bytes
#: Bounds of the counts per unit of force or torque; values outside are an error and could make a force infinite.
MIN_COUNTS, MAX_COUNTS = 1e-6, 1e15
_NUMBER = re.compile(r"\d{1,20}(\.\d{0,20})?([eE][+-]?\d{1,3})?", re.ASCII)


class PageError(CtrError):
    """An invalid configuration page; the message names the element, its text and what was expected."""


@dataclass(frozen=True)
class NetftPage:
    """Content of a box's configuration page."""

    product: str
    serial: str  #: serial number of the calibration, which identifies a sensor; "" if the page has none
    force_count: float  #: force per count [N]
    torque_count: float  #: torque per count [N m]
    ranges: tuple[float, ...] | None  #: the calibration's six ranges [N, N m]; None if the page has none


def read_page(page: bytes) -> NetftPage:
    """Read `netftapi2.xml`.

    Raises:
        PageError: the page is invalid; the message names the element, its text and what was expected.
    """
    texts = _texts(page)
    for name in REQUIRED_FIELDS:
        if name not in texts:
            raise PageError(f"netftapi2.xml has no <{name}>; is this an ATI Net F/T?")
    force = _unit(texts["scfgfu"], "scfgfu", FORCE_UNITS)
    torque = _unit(texts["scfgtu"], "scfgtu", TORQUE_UNITS)
    if not texts["prodname"]:
        raise PageError("netftapi2.xml: <prodname> is empty; expected the name of the product")
    return NetftPage(
        product=texts["prodname"],
        serial=texts.get("cfgcalsn", ""),
        force_count=force / _counts(texts["cfgcpf"], "cfgcpf"),
        torque_count=torque / _counts(texts["cfgcpt"], "cfgcpt"),
        ranges=_ranges(texts.get("cfgmr"), force, torque),
    )


def _texts(page: bytes) -> dict[str, str]:
    """Return the text of each required or optional element."""
    if len(page) > MAX_PAGE_BYTES:
        raise PageError(f"netftapi2.xml has {len(page)} bytes; at most {MAX_PAGE_BYTES} are read")
    found: dict[str, str] = {}
    known_fields = {*REQUIRED_FIELDS, *OPTIONAL_FIELDS}
    inside: list[str] = []  # name of the required or optional element that the parser is inside of

    def start(name: str, _: dict[str, str]) -> None:
        if inside:
            raise PageError(f"netftapi2.xml: <{inside[0]}> contains <{name}>; expected text only")
        if name in known_fields:
            if name in found:
                raise PageError(f"netftapi2.xml has <{name}> twice; expected it once")
            found[name] = ""
            inside.append(name)

    def end(_: str) -> None:
        inside.clear()

    def text(data: str) -> None:
        if inside:
            found[inside[0]] += data

    def doctype(*_: object) -> None:
        raise PageError("netftapi2.xml has a DOCTYPE; a Net F/T sends none")

    parser = expat.ParserCreate()
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = text
    parser.StartDoctypeDeclHandler = doctype
    try:
        parser.Parse(page, True)
    except (expat.ExpatError, ValueError, LookupError) as error:  # ValueError, LookupError: an unknown encoding
        raise PageError(f"netftapi2.xml is not well-formed: {error}") from None
    return {name: value.strip() for name, value in found.items()}


def _unit(name: str, element: str, units: dict[str, float]) -> float:
    if name not in units:
        raise PageError(f"netftapi2.xml: <{element}> is '{name[:40]}'; expected one of {', '.join(units)}")
    return units[name]


def _counts(text: str, element: str) -> float:
    counts = float(text) if _NUMBER.fullmatch(text) else math.nan
    if not MIN_COUNTS <= counts <= MAX_COUNTS:
        raise PageError(
            f"netftapi2.xml: <{element}> is '{text[:40]}' counts per unit; "
            f"expected a number in {MIN_COUNTS:g} ... {MAX_COUNTS:g}"
        )
    return counts


def _ranges(text: str | None, force: float, torque: float) -> tuple[float, ...] | None:
    """Return the six ranges, separated by `;`, `,` or blanks; None if they are not six positive numbers."""
    parts = re.split(r"[;,\s]+", text) if text else []
    if len(parts) != 6 or not all(_NUMBER.fullmatch(part) for part in parts):
        return None
    values = [float(part) * unit for part, unit in zip(parts, [force] * 3 + [torque] * 3, strict=True)]
    return tuple(values) if all(0.0 < value < math.inf for value in values) else None
