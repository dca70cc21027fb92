"""The rule of conftest.py at work: each test file below is run by a pytest of its own."""

from pathlib import Path

import pytest

pytest_plugins = ["pytester"]

CONFTEST = Path(__file__).parents[1].joinpath("conftest.py").read_text(encoding="utf-8")

PRELUDE = """
import socket, subprocess, sys, threading, time
import pytest

KEPT = []  # what is dropped closes itself, with a warning that pytest reports anyway

@pytest.fixture
def grace():
    return 0.3
"""

THREAD = "KEPT.append(threading.Thread(target=time.sleep, args=(1.5,), name='lost')); KEPT[0].start()"
CHILD = "KEPT.append(subprocess.Popen([sys.executable, '-S', '-c', 'import time; time.sleep(1.5)']))"
TCP = "KEPT.append(socket.create_server(('127.0.0.1', 0)))"
UDP = "KEPT.append(socket.socket(type=socket.SOCK_DGRAM)); KEPT[0].bind(('127.0.0.1', 0))"
CHILDS_PORT = """
    code = "import socket, time; s = socket.create_server(('127.0.0.1', 0)); print(flush=True); time.sleep(1.5)"
    KEPT.append(subprocess.Popen([sys.executable, '-S', '-c', code], stdout=subprocess.PIPE))
    KEPT[0].stdout.readline()
"""


@pytest.fixture
def run(pytester: pytest.Pytester):
    """Run test code under the project's conftest.py in a process of its own."""

    def run(body: str) -> pytest.RunResult:
        pytester.makeconftest(CONFTEST)
        pytester.makepyfile(PRELUDE + body)
        return pytester.runpytest_subprocess("-p", "no:cacheprovider")

    return run


@pytest.mark.parametrize(
    ("leak", "named"),
    [
        (THREAD, "thread lost"),
        (CHILD, r"process \d+ \(python"),
        (TCP, r"port \d+"),
        (UDP, r"port \d+"),
        (CHILDS_PORT, r"port \d+, process \d+"),
    ],
    ids=["thread", "child", "tcp", "udp", "port of a child"],
)
def test_what_a_test_leaves_behind_fails_it_by_name_and_the_next_test_is_not_blamed(run, leak, named):
    result = run(f"def test_leaks():\n    {leak.strip()}\n\ndef test_next():\n    pass\n")

    result.assert_outcomes(passed=2, errors=1)
    result.stdout.re_match_lines([r".*ERROR at teardown of test_leaks.*", rf".*left behind: .*{named}"])


def test_a_tidy_test_and_one_whose_thread_ends_within_the_grace_pass(run):
    result = run(
        "def test_tidy():\n"
        "    with socket.create_server(('127.0.0.1', 0)):\n"
        "        subprocess.run([sys.executable, '-S', '-c', ''], check=True)\n\n"
        "def test_ends_soon():\n"
        "    threading.Thread(target=time.sleep, args=(0.1,)).start()\n"
    )

    result.assert_outcomes(passed=2)


def test_what_a_module_shares_is_not_the_tests(run):
    result = run(
        "@pytest.fixture(scope='module')\n"
        "def server():\n"
        "    with socket.create_server(('127.0.0.1', 0)) as server:\n"
        "        yield server\n\n"
        "def test_first(server):\n    pass\n\n"
        "def test_second(server):\n    pass\n"
    )

    result.assert_outcomes(passed=2)
