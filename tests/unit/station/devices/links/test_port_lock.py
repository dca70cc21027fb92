"""Lock files that were never released."""

import tempfile
from pathlib import Path

import pytest

from station.devices.links.link import PortInUse, PortLock, clear_left_behind, lock_file


def test_unlocked_files_are_removed_and_a_device_in_use_stays_locked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    left, linked, other = lock_file("/dev/ttyUSB8"), tmp_path / "ctr-station-link.lock", tmp_path / "another.lock"
    for path in (left, other):
        path.write_text("123456789")
    linked.symlink_to(other)
    lock = PortLock("/dev/ttyUSB9")

    clear_left_behind()

    assert not left.exists()
    assert linked.is_symlink()
    assert other.exists()
    with pytest.raises(PortInUse, match="two devices cannot have one port"):
        PortLock("/dev/ttyUSB9")
    lock.release()
    PortLock("/dev/ttyUSB8").release()
