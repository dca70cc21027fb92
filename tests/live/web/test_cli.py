"""Signals that end the station."""

import subprocess
import sys


def test_a_signal_is_reported_although_a_finalizer_drops_its_exception() -> None:
    program = (
        "import os, signal\n"
        "from web.cli import exit_on_signal\n"
        "class Finalized:\n"
        "    def __del__(self):\n"
        "        os.kill(os.getpid(), signal.SIGTERM)\n"
        "with exit_on_signal() as interrupted:\n"
        "    assert not interrupted()\n"
        "    one = Finalized()\n"
        "    del one\n"
        "    print(interrupted())\n"
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert ended.stdout == "True\n", ended.stderr
    assert "Exception ignored in" in ended.stderr
