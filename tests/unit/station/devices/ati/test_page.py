"""The Net F/T page is read strictly (counts, units, identity), because an error would scale the forces."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from station.devices.ati.calibration import PageError, read_page

ELEMENTS = {
    "prodname": "Net F/T",
    "cfgcpf": "1000000",
    "cfgcpt": "1000000",
    "scfgfu": "N",
    "scfgtu": "N-m",
}


def page(extra: str = "", head: str = '<?xml version="1.0"?>', **changes: str | None) -> bytes:
    """Return a page with changed elements; None omits an element."""
    elements = {**ELEMENTS, **changes}
    body = "".join(f"<{name}>{text}</{name}>\n" for name, text in elements.items() if text is not None)
    return f"{head}<netft><runft>1;2;3;4;5;6</runft>{body}{extra}</netft>".encode()


def test_page_gives_force_and_torque_per_count():
    read = read_page(page())

    assert (read.product, read.serial, read.ranges) == ("Net F/T", "", None)
    assert (read.force_count, read.torque_count) == (1e-6, 1e-6)


@pytest.mark.parametrize(
    ("unit", "newtons"), [("N", 1.0), ("kN", 1000.0), ("lbf", 4.44822), ("klbf", 4448.22), ("kgf", 9.80665)]
)
def test_force_units_are_converted_to_newtons(unit, newtons):
    assert read_page(page(scfgfu=unit, cfgcpf="1000")).force_count == pytest.approx(newtons / 1000.0, rel=1e-5)


@pytest.mark.parametrize(
    ("unit", "newton_metres"),
    [
        ("N-m", 1.0),
        ("Nm", 1.0),
        ("N-mm", 1e-3),
        ("Nmm", 1e-3),
        ("kN-m", 1e3),
        ("lbf-in", 4.44822 * 0.0254),
        ("lbf-ft", 4.44822 * 0.3048),
        ("kgf-cm", 9.80665e-2),
        ("kg-cm", 9.80665e-2),
    ],
)
def test_torque_units_are_converted_to_newton_metres(unit, newton_metres):
    assert read_page(page(scfgtu=unit, cfgcpt="1000")).torque_count == pytest.approx(newton_metres / 1000.0, rel=1e-5)


@pytest.mark.parametrize("text", ["18;18;18;250;250;250", "18,18,18,250,250,250", "18 18 18 250 250 250"])
def test_identity_and_range_are_optional_in_the_page(text):
    read = read_page(page(scfgtu="N-mm", cfgcalsn="FT12345", cfgmr=text))

    assert read.serial == "FT12345"
    assert read.ranges == pytest.approx((18.0, 18.0, 18.0, 0.25, 0.25, 0.25))


@pytest.mark.parametrize("text", ["0;0;0;0;0;0", "18;18;18", "a;b;c;d;e;f", ""])
def test_invalid_range_is_ignored(text):
    assert read_page(page(cfgmr=text)).ranges is None


@pytest.mark.parametrize("name", ELEMENTS)
def test_missing_element_of_the_page_is_named(name):
    with pytest.raises(PageError, match=f"no <{name}>"):
        read_page(page(**{name: None}))


@pytest.mark.parametrize("name", ELEMENTS)
def test_duplicate_element_of_the_page_is_named(name):
    with pytest.raises(PageError, match=f"<{name}> twice"):
        read_page(page(extra=f"<{name}>{ELEMENTS[name]}</{name}>"))


@pytest.mark.parametrize(
    "text", ["0", "-1", "nan", "inf", "1e400", "1e-300", "", "1_000", "0x10", "1,5", "++1", "\u0661"]
)
@pytest.mark.parametrize("name", ["cfgcpf", "cfgcpt"])
def test_counts_must_be_positive_finite_numbers(name, text):
    with pytest.raises(PageError, match=f"<{name}>"):
        read_page(page(**{name: text}))


@pytest.mark.parametrize(("name", "text"), [("scfgfu", "n"), ("scfgfu", "N-m"), ("scfgtu", "N"), ("scfgtu", "")])
def test_unknown_unit_on_the_sensors_page_is_refused_with_its_name(name, text):
    with pytest.raises(PageError, match=f"<{name}> is '{text}'"):
        read_page(page(**{name: text}))


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (page(head='<!DOCTYPE netft [<!ENTITY a "1000000">]>', cfgcpf="&a;"), "DOCTYPE"),
        (page(cfgcpf="<b>1000000</b>"), "contains <b>"),
        (page()[:-3], "well-formed"),
        (page().replace(b"</scfgfu>", b"</scfgtu>"), "well-formed"),
        (page(head='<?xml version="1.0" encoding="ebcdic-9"?>'), "well-formed"),
        (b"", "well-formed"),
        (b"<html><body>Not here</body></html>", "no <prodname>"),
        (page(extra="<x>" + "a" * 300_000 + "</x>"), "bytes"),
    ],
)
def test_invalid_page_is_refused(data, reason):
    with pytest.raises(PageError, match=reason):
        read_page(data)


@given(st.binary(max_size=300))
def test_random_bytes_are_refused_as_a_page(data):
    with pytest.raises(PageError):
        read_page(data)
