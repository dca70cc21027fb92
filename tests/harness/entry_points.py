"""Entry points as an installed package has them."""

from collections.abc import Mapping
from pathlib import Path


def install_entry_points(folder: Path, groups: Mapping[str, Mapping[str, str]], name: str = "my-bench") -> None:
    """Write the metadata of a package with these entry points, by group and name, into a folder of the import path."""
    installed = folder / f"{name.replace('-', '_')}-1.0.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n", encoding="utf-8")
    lines = [line for group, names in groups.items() for line in (f"[{group}]", *map(" = ".join, names.items()))]
    (installed / "entry_points.txt").write_text("\n".join(lines), encoding="utf-8")
