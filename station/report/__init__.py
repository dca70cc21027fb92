"""Pages and figures of runs.

Before matplotlib is imported, by whichever module: its folder is in the cache, where its list of fonts is anyhow. A
home that takes nothing else would be complained of, and nobody's own settings change how a report looks.
"""

import contextlib
import os
from pathlib import Path

CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "matplotlib")

if "MPLCONFIGDIR" not in os.environ:
    with contextlib.suppress(OSError):  # then matplotlib finds a place by itself, and says so
        CACHE.mkdir(parents=True, exist_ok=True)
        os.environ["MPLCONFIGDIR"] = str(CACHE)
