"""Report pages and figures of runs.

This module sets the configuration folder of matplotlib before any module imports matplotlib. The folder is in the
user's cache, where matplotlib also keeps its list of fonts. So an unwritable home folder causes no warning, and
the user's matplotlib settings do not change the style of a report.
"""

import contextlib
import os
from pathlib import Path

if "MPLCONFIGDIR" not in os.environ:
    # Without a home folder, or if the folder cannot be created, matplotlib uses another folder and warns.
    with contextlib.suppress(OSError, RuntimeError):
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "matplotlib")
        folder.mkdir(parents=True, exist_ok=True)
        os.environ["MPLCONFIGDIR"] = str(folder)
