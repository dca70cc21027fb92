"""A script's side of the station is light: it needs httpx, and nothing else that the station needs."""

import subprocess
import sys

from tests.harness.root import ROOT

#: Prints what is imported by a statement, in a process of its own.
LOADED = "import sys; import httpx; had = set(sys.modules); {}; print(*sorted(set(sys.modules) - had))"


def loaded(statement: str) -> set[str]:
    command = [sys.executable, "-c", LOADED.format(statement)]
    return set(subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT).stdout.split())


def test_the_client_needs_httpx_and_nothing_else():
    roots = {name.split(".")[0] for name in loaded("import station.client")}
    assert roots - sys.stdlib_module_names == {"core", "station"}


def test_the_command_line_does_not_load_the_model_before_it_knows_what_is_asked():
    roots = {name.split(".")[0] for name in loaded("import web.cli")}
    assert roots >= {"station", "web", "pydantic"}
    assert not roots & {"numpy", "numba", "scipy", "matplotlib", "pyarrow", "viser", "fastapi"}
