"""The second look of CI at tests that failed, with small test files of every kind."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.harness.failures import Failure
from tests.harness.root import ROOT
from tests.tools.second_look import LARGEST, never

#: Fails in the first of all runs and passes in all later ones.
FAILS_ONCE = """
    from pathlib import Path
    mark = Path(__file__).with_name({name!r})
    if not mark.exists():
        mark.touch()
        raise AssertionError("the title was\\n'NO ANSWER'")
"""
STEADY = "def test_steady():\n    pass\n"
UNSTEADY = f"def test_unsteady():{FAILS_ONCE.format(name='unsteady')}"
WRONG = "def test_wrong():\n    assert 1 == 2\n"
#: Passes alone, but not after the other test of its file.
NEEDS_ITS_ORDER = f"""
def test_before(): globals().update(before=True)
def test_needs_its_order():{FAILS_ONCE.format(name="order")}
    assert "before" not in globals()
"""
KILLS_ITS_WORKER = "import os\ndef test_kills():\n    os._exit(3)\n"
GUARDS_STOP = f"def test_stop_ends_a_motion():{FAILS_ONCE.format(name='stop')}"
LEAVES_SOMETHING = f"""
import pytest
@pytest.fixture
def process():
    yield{FAILS_ONCE.format(name="left")}
def test_leaves_something(process): pass
"""

Look = Callable[..., tuple[int, list[str]]]


@pytest.fixture
def look(tmp_path: Path) -> Look:
    """Return a function that runs `.ci/live` on files with the given texts; it returns exit status and verdicts."""

    def look(*arguments: str, **texts: str) -> tuple[int, list[str]]:
        folder, verdicts = tmp_path / "toys", tmp_path / "verdicts"
        folder.mkdir()
        for name, text in texts.items():
            (folder / f"test_{name}.py").write_text(text, encoding="utf-8")
        done = subprocess.run(
            ["bash", str(ROOT / ".ci" / "live"), str(folder), *arguments],
            env={**os.environ, "CI_VERDICTS": str(verdicts)}, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert verdicts.exists(), done.stdout + done.stderr
        lines = sorted(line.replace(f"{folder}/", "") for line in verdicts.read_text(encoding="utf-8").splitlines())
        return done.returncode, lines

    return look


def test_run_with_one_unsteady_test_is_green_and_names_it_with_its_first_message(look: Look) -> None:
    status, (line,) = look("-n", "0", steady=STEADY, unsteady=UNSTEADY)

    assert status == 0
    assert line.startswith("UNSTEADY test_unsteady.py::test_unsteady [call; load ")
    assert line.endswith("]: AssertionError: the title was 'NO ANSWER'")


def test_tests_that_fail_again_alone_or_with_their_file_are_refused(look: Look) -> None:
    status, (wrong, order) = look("-n", "0", wrong=WRONG, order=NEEDS_ITS_ORDER)

    assert status == 1
    assert order.startswith("REFUSED (failed again with its whole file) test_order.py::test_needs_its_order")
    assert wrong.startswith("REFUSED (failed again alone, run 1 of 3) test_wrong.py::test_wrong")


def test_dead_worker_refuses_the_run_and_every_test_that_failed_in_it(look: Look) -> None:
    status, lines = look("-n", "2", kills=KILLS_ITS_WORKER, unsteady=UNSTEADY)

    assert status == 1
    assert {line.partition(")")[0] for line in lines} == {"REFUSED (no second look after the death of a worker"}
    assert any("test_kills.py::test_kills" in line for line in lines)


def test_process_that_ends_without_naming_a_test_refuses_the_run(look: Look) -> None:
    assert look("-n", "0", kills=KILLS_ITS_WORKER) == (1, ["REFUSED pytest ended with status 3 and named no test"])


def test_test_of_stop_and_one_that_leaves_something_behind_get_no_second_look(look: Look) -> None:
    status, (stop, left) = look("-n", "0", guards=GUARDS_STOP, leaves=LEAVES_SOMETHING)

    assert status == 1
    assert stop.startswith("REFUSED (no second look after a failure of the phase teardown) test_leaves.py")
    assert left.startswith("REFUSED (no second look at a test of faults, STOP, limits or leases) test_guards.py")


def test_more_than_four_failed_tests_are_refused_without_a_second_look(look: Look) -> None:
    many = "".join(UNSTEADY.replace("unsteady", f"unsteady_{number}") for number in range(LARGEST + 1))
    status, lines = look("-n", "0", many=many)

    assert status == 1
    assert len(lines) == LARGEST + 1
    assert all(line.startswith("REFUSED (more than 4 tests failed)") for line in lines)


def test_file_of_failures_does_not_change_the_configuration_of_the_project(tmp_path: Path) -> None:
    plug_in = ("-p", "tests.harness.failures", f"--failures={tmp_path / 'failures'}")
    command = [sys.executable, "-m", "pytest", *plug_in, "-n", "0", "--collect-only", "tests/unit/test_version.py"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("tests/unit/test_version.py::")


@pytest.mark.parametrize(
    ("name", "guards"),
    [
        ("tests/live/faults/test_hold.py::test_run_ends_in_hold", True),
        ("tests/live/browser/test_stop.py::test_button", True),
        ("tests/live/web/test_app.py::test_emergency_stop_is_sent", True),
        ("tests/live/web/test_lease.py::test_it_ends", True),
        ("tests/live/web/test_app.py::test_page_has_a_title", False),
        ("tests/live/station/test_stopwatch.py::test_unlimited", False),
    ],
)
def test_faults_stop_limits_and_leases_are_recognised_by_their_names(name: str, guards: bool) -> None:
    assert (never([Failure(f"{ROOT}/{name}", "call", "", "")], LARGEST) != "") is guards
