"""The client and the command line import only few modules, so that they start fast."""

import subprocess
import sys

from tests.harness.root import ROOT

#: Program that prints the modules that a statement imports; it runs in a separate process.
LOADED = "import sys; import httpx; had = set(sys.modules); {}; print(*sorted(set(sys.modules) - had))"


def loaded(statement: str) -> set[str]:
    command = [sys.executable, "-c", LOADED.format(statement)]
    return set(subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT).stdout.split())


def test_client_module_imports_only_httpx_and_the_standard_library():
    roots = {name.split(".")[0] for name in loaded("import station.client")}
    assert roots - sys.stdlib_module_names == {"core", "station"}


def test_command_line_does_not_load_the_model_before_it_parses_the_command():
    roots = {name.split(".")[0] for name in loaded("import web.cli")}
    assert roots >= {"station", "web", "pydantic"}
    assert not roots & {"numpy", "numba", "scipy", "matplotlib", "pyarrow", "viser", "fastapi"}
