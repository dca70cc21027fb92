"""Where this project lies: processes that tests start find it from there."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
