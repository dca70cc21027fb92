"""Root folder of this project, for processes that tests start."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
