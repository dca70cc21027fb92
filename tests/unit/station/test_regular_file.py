"""Opening of regular files only."""

import os
import socket

import pytest

from station.regular_file import NotRegularError, is_regular, open_in, open_to_append, read_in


def make(kind, path, elsewhere):
    """Create something at a path; `elsewhere` is a regular file."""
    if kind == "link":
        path.symlink_to(elsewhere)
    elif kind == "dangling link":
        path.symlink_to(elsewhere.parent / "none")
    elif kind == "folder":
        path.mkdir()
    elif kind == "FIFO":
        os.mkfifo(path)
    elif kind == "device":
        os.mknod(path, 0o20666, os.makedev(1, 5))  # /dev/zero
    elif kind == "socket":
        with socket.socket(socket.AF_UNIX) as listening:
            here = os.open(path.parent, os.O_RDONLY)
            listening.bind(f"/proc/self/fd/{here}/{path.name}")  # the path of a socket has at most 107 bytes
            os.close(here)


KINDS = ["link", "dangling link", "folder", "FIFO", "device", "socket"]


@pytest.mark.parametrize("kind", KINDS)
def test_only_regular_files_are_opened(tmp_path, kind):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.write_text("secret")
    (tmp_path / "run").mkdir()
    try:
        make(kind, tmp_path / "run" / "file", elsewhere)
    except PermissionError:
        pytest.skip("only root may create a device")
    assert not is_regular(tmp_path / "run" / "file")
    with pytest.raises(NotRegularError, match=r"is a (link|folder|FIFO|device|socket), not a regular file"):
        open_in(tmp_path / "run", "file")
    with pytest.raises(NotRegularError):
        open_to_append(tmp_path / "run" / "file")
    assert elsewhere.read_text() == "secret"


def test_a_file_is_not_opened_through_a_linked_folder(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "file").write_bytes(b"x")
    (tmp_path / "link").symlink_to(tmp_path / "run")
    assert read_in(tmp_path / "run", "file") == b"x"
    with pytest.raises(NotRegularError, match="'link' is a link or a file, not a folder"):
        read_in(tmp_path / "link", "file")


@pytest.mark.parametrize("name", ["../file", "/etc/passwd", "..", ".", "", "cameras/x"])
def test_a_name_does_not_leave_the_folder(tmp_path, name):
    (tmp_path / "file").write_bytes(b"x")
    (tmp_path / "run").mkdir()
    with pytest.raises(NotRegularError, match="not the name of a file"):
        read_in(tmp_path / "run", name)


def test_a_missing_file_is_reported_as_missing(tmp_path):
    with pytest.raises(FileNotFoundError):
        open_in(tmp_path, "none")
