"""The built wheel works like the source when it is installed without the source."""

import importlib.util
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import sysconfig
import venv
import zipfile
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import httpx
import pytest

from tests.harness.cases import SHORT
from tests.harness.root import ROOT
from tests.harness.serving import calm
from tests.harness.waiting import NET

MISSING = [name for name in ("build", "hatchling", "pip") if importlib.util.find_spec(name) is None]
pytestmark = pytest.mark.skipif(bool(MISSING), reason=f"builds the package: needs {', '.join(MISSING)}")
PARTS = ("core", "station", "web")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel with the installed packages; nothing is downloaded."""
    out = tmp_path_factory.mktemp("dist")
    subprocess.run(
        [sys.executable, "-m", "build", "--wheel", "--no-isolation", "-o", out, ROOT],
        check=True, capture_output=True, timeout=NET,
    )  # fmt: skip
    (made,) = out.glob("*.whl")
    return made


@pytest.fixture(scope="module")
def environment(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Create a virtual environment with the wheel and the installed libraries, but without access to the source."""
    place = tmp_path_factory.mktemp("environment")
    venv.create(place, with_pip=False)
    (packages,) = place.glob("lib/python*/site-packages")
    libraries = {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}
    # The libraries are added as plain folders, so that their .pth files (of editable installations) have no effect.
    (packages / "libraries.pth").write_text("\n".join(libraries), encoding="utf-8")
    pip = [sys.executable, "-m", "pip", "--python", place / "bin" / "python", "install", "-q", "--no-index"]
    subprocess.run([*pip, "--no-deps", "--no-compile", wheel], check=True, timeout=NET)
    # The model's compiled cache depends on the content of the source files, not on their folder, so it can be reused.
    for part in PARTS:
        for code in (ROOT / part).rglob("__pycache__/*.nb[ic]"):
            there = packages / code.relative_to(ROOT)
            if there.parents[1].is_dir():  # a checkout can still hold the cache of a folder that was moved
                there.parent.mkdir(exist_ok=True)
                shutil.copy(code, there)
    (place / "home").mkdir()
    installed = [packages, *(path for path in packages.rglob("*") if path.is_dir()), place / "home"]
    for folder in installed:
        folder.chmod(0o555)
    yield place
    for folder in installed:
        folder.chmod(0o755)


Start = Callable[..., AbstractContextManager["subprocess.Popen[str]"]]


@pytest.fixture
def start(environment: Path, tmp_path: Path) -> Start:
    """Return a function that starts the installed command in an empty folder, with a home folder for caches only."""
    known = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "NUMBA_", "CTR_"))}
    own = {"HOME": str(environment / "home"), "XDG_CACHE_HOME": str(environment / "cache")}

    @contextmanager
    def start(*arguments: object, **more: str) -> Iterator["subprocess.Popen[str]"]:
        command = [str(environment / "bin" / "ctr-station"), *map(str, arguments)]
        pipe = subprocess.PIPE
        with subprocess.Popen(
            command, cwd=tmp_path, env={**known, **own, **more}, text=True, stdout=pipe, stderr=subprocess.STDOUT
        ) as process:
            try:
                yield process
            finally:
                process.kill()  # does nothing to a process that has ended

    return start


@pytest.fixture
def call(start: Start) -> Callable[..., str]:
    """Return a function that runs the installed command to its end and returns its output."""

    def call(*arguments: object) -> str:
        with start(*arguments) as process:
            said, _ = process.communicate(timeout=NET)
        assert process.returncode == 0, said
        return said

    return call


def test_wheel_has_every_source_file_and_every_file_that_its_pages_link_to(wheel: Path):
    source = [path for part in PARTS for path in (ROOT / part).rglob("*") if path.is_file()]
    wanted = {path.relative_to(ROOT).as_posix() for path in source if "__pycache__" not in path.parts}
    wanted.remove("web/ctr_station.py")  # the wheel has this module under another name
    # These files only build the site.
    site = r"station/docs/(mkdocs.yml|site_pages.py)"
    wanted = {path for path in wanted if not re.match(site, path)}
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        assert wanted <= names
        assert {name.split("/")[0] for name in names if ".dist-info/" not in name} == {*PARTS, "ctr_station.py"}
        for page in (name for name in names if name.endswith(".md")):
            for link in re.findall(r"\]\(([^)#:\s]+)[)#]", archive.read(page).decode()):
                assert os.path.normpath(Path(page).parent / link) in names, f"{page} links to {link}"


@pytest.mark.parametrize("name", PARTS)
def test_command_refuses_another_project_with_the_same_package_name(start: Start, tmp_path: Path, name: str):
    (tmp_path / name).mkdir()
    (tmp_path / name / "__init__.py").write_text("raise RuntimeError('another package')\n", encoding="utf-8")
    with start("keys", PYTHONPATH=str(tmp_path)) as process:
        said, _ = process.communicate(timeout=NET)
    assert process.returncode == 2
    (line,) = said.splitlines()
    assert line.startswith(
        f"ctr-station: the package '{name}' found at {tmp_path / name / '__init__.py'} belongs to another project"
    )


def test_installed_commands_find_presets_pages_and_player(call: Callable[..., str], tmp_path: Path):
    assert call("keys").startswith("# Configuration files\n")
    (tmp_path / "short.toml").write_text(SHORT, encoding="utf-8")
    call("run", "short.toml")
    call("report", "latest")
    call("replay", "latest")
    call("export", "latest", "--format", "csv")
    (run,) = (tmp_path / "runs").iterdir()
    assert {path.name for path in run.iterdir()} >= {"short.mcap", "summary.json", "report.html", "short.csv"}


def test_installed_lab_command_serves_its_devices(start: Start):
    with start("lab") as process:
        assert process.stdout is not None
        assert json.loads(process.stdout.readline())
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=NET)


def test_installed_station_serves_its_page(start: Start, tmp_path: Path):
    (tmp_path / "station.toml").write_text(calm(0.5), encoding="utf-8")
    with start("serve", "--no-browser", "--port", 0, "--config", "station.toml") as process:
        assert process.stdout is not None
        said = ""
        while (found := re.search(r"is at (http://\S+/)", said)) is None:
            said += (line := process.stdout.readline())
            assert line, said
        with httpx.Client(base_url=found[1], timeout=NET) as rest:
            page = rest.get("/").text
            assert rest.get("/api/status").json()["format"] == 1
            linked = re.findall(r'(?:src|href)="/?(static/[^"]+)"', page)
            assert "static/main.js" in linked
            assert all(rest.get(f"/{link}").status_code == 200 for link in linked)
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=NET)
        assert process.returncode == 0


def test_container_build_steps_fit_the_package(wheel: Path, call: Callable[..., str], environment: Path):
    text = call("doctor", "--print", "dockerfile")
    steps = dict(re.findall(r"^([A-Z]+) (.*)$", text, re.MULTILINE))
    assert list(wheel.parent.glob(steps["COPY"].split()[0])) == [wheel]
    (command,) = json.loads(steps["ENTRYPOINT"])
    assert os.access(environment / "bin" / command, os.X_OK)
    said, *options = json.loads(steps["CMD"])
    known = call(said, "--help")
    assert all(option in known for option in options if option.startswith("--"))
    assert f"install -d -o {steps['USER']} {' '.join(json.loads(steps['VOLUME']))}\n" in text
