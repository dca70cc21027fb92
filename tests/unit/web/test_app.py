"""The imports of the web application."""

import subprocess
import sys

from tests.harness.root import ROOT

SCRIPT = "import sys, web.app; print(*{name.split('.')[0] + '.' + name.split('.')[-1] for name in sys.modules})"


def test_the_application_does_not_import_plotting_and_fitting_packages() -> None:
    loaded = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True, cwd=ROOT)
    assert "web.app" in loaded.stdout.split()
    assert {"matplotlib.matplotlib", "scipy.spatial", "scipy.optimize"}.isdisjoint(loaded.stdout.split())
