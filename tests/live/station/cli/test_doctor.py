"""Findings of `ctr-station doctor` about this computer."""

from station.cli.doctor import findings
from station.control.realtime import may_lock_memory


def test_every_finding_of_doctor_has_a_text_and_the_timer_is_measured():
    found = {finding.subject: finding for finding in findings()}
    assert list(found) == [
        "Python",
        "processors",
        "real time",
        "timer",
        "memory",
        "shared memory",
        "sleep",
        "serial ports",
        "port rights",
        "udev rules",
        "service",
        "browser",
    ]
    assert all(finding.text for finding in found.values())
    assert found["memory"].good == may_lock_memory()
    assert "times by 2 ms or more" in found["timer"].text
    # The timer runs for 3 s at 500 Hz; a busy computer misses some of its ticks.
    woken = int(found["timer"].text.split(" of ")[1].split()[0])
    assert 100 < woken < 1800
    assert found["timer"].good == (" and 0 of " in found["timer"].text)
