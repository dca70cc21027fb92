"""Every function of a tick is ready before the loop runs, for each controller, motion, region, stream and jog."""

import subprocess
import sys

from tests.harness.root import ROOT


def test_no_feature_needs_a_function_that_was_not_rehearsed() -> None:
    # Another process, because earlier tests have compiled or loaded the functions in this one.
    done = subprocess.run(
        [sys.executable, "-m", "tests.harness.every_feature", "three_tubes"],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.stdout, done.returncode) == ("", 0), done.stderr
