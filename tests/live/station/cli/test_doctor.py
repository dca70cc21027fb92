"""What the machine offers, in words that a person can act on."""

from station.cli.doctor import findings
from station.control.realtime import may_lock_memory


def test_every_finding_has_words_and_what_is_not_good_says_what_to_do():
    found = {finding.subject: finding for finding in findings()}
    assert list(found) == [
        "Python",
        "processors",
        "real time",
        "timer",
        "memory",
        "shared memory",
        "serial ports",
        "port rights",
        "udev rules",
        "service",
        "browser",
    ]
    assert all(finding.text for finding in found.values())
    assert found["memory"].good == may_lock_memory()
    assert "times by 2 ms or more" in found["timer"].text
    # 3 s of a 500 Hz timer, less what a busy computer swallowed.
    woken = int(found["timer"].text.split(" of ")[1].split()[0])
    assert 100 < woken < 1800
    assert found["timer"].good == (" and 0 of " in found["timer"].text)
