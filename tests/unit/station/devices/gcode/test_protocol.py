"""Lines of G-code boards: checksums, positions, alarms, and damaged lines."""

import pytest

from station.devices.gcode.protocol import Alarm, Info, LineReader, Ok, Position, Resend, Started, numbered, parse

AXES = ("X", "Y", "Z")


def test_numbered_line_has_the_checksum_of_the_published_example():
    assert numbered(3, "T0") == b"N3 T0*57\n"  # RepRap's page about G-code, section "Checking"


@pytest.mark.parametrize(
    ("dialect", "line", "message"),
    [
        ("grbl", "ok", Ok()),
        ("marlin", "ok N12 P15 B3", Ok()),
        ("marlin", "Resend: 17", Resend(17)),
        ("marlin", "start", Started("start")),
        ("grbl", "<Jog|MPos:1.000,-2.500,30.125|FS:500,0>", Position((1.0, -2.5, 30.125), "Jog")),
        (
            "marlin",
            "X:1.00 Y:-2.50 Z:30.12 E:0.00 Count X:80 Y:-200 Z:12048",
            Position((80.0, -200.0, 12048.0), "", (1.0, -2.5, 30.12)),
        ),
    ],
)
def test_line_of_a_board_has_its_meaning(dialect, line, message):
    assert parse(dialect, line, AXES) == message


def test_alarm_of_grbl_is_reported_with_the_makers_meaning():
    message = parse("grbl", "ALARM:1", AXES)
    assert isinstance(message, Alarm)
    assert "limit switch" in message.text


@pytest.mark.parametrize(
    "line",
    [
        "X:1.00 Y:-2.50 Z:30.12 E:0.00 Count X:74471Y:399961 Z:12048",
        "X:1.00 Y:-2.50 Z:30.12 Count X:80 Y:-200",
        f"X:1.00 Y:-2.50 Z:30.12 Count X:80 Y:-200 Z:{'9' * 400}",
        "X:1.00 Y:-2.5 Z:30.12 E:0.00 Count X:80 Y:-200 Z:12048",
        "X:1.00 Y:-2.50 Z:30.12 E:0.00 Count X:80 Y:-200 Z:012048",
        "X:1.00 Y:-2.50 Y:30.12 Z:0.00 Count X:80 Y:-200 Z:12048",
        "X:1.00 X:-2.50 Z:30.12 Count X:80 X:-200 Z:12048",
    ],
)
def test_damaged_position_of_marlin_is_no_position(line):
    assert parse("marlin", line, AXES) == Info(line)


@pytest.mark.parametrize(
    "line",
    [
        "<Jog|MPos:1.00,-2.500,30.125|FS:500,0>",
        "<Jog|MPos:1.000,-2.50030.125|FS:500,0>",
        "<Jog|MPos:1.000,-2.500|FS:500,0>",
        "<Jog|MPos:1.000,-2.500,030.125|FS:500,0>",
        "<Jog|MPos:1.000,-2.500,30.125>",
        "<Jig|MPos:1.000,-2.500,30.125|FS:500,0>",
        "<Jog|MPos:1.000,-2.500,30.125|FS:500,0",
    ],
)
def test_damaged_position_of_grbl_is_no_position(line):
    assert parse("grbl", line, AXES) == Info(line)


def test_reader_joins_the_parts_of_a_line_and_drops_what_is_not_ascii():
    reader = LineReader()
    assert reader.feed(b"o") == []
    assert reader.feed(b"k\r\n\xff\xfeok\nerror:9\n") == ["ok", "error:9"]
    assert reader.dropped == 4
