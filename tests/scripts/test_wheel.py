# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The wheel of the desk commands: complete, without ROS, and usable in its own environment."""

import json
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from fixtures.documents import code_of
from fixtures.newcomer import write_log

from trackslip_common import __version__

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def hatchling() -> None:
    pytest.importorskip("hatchling", reason="make wheel installs it")


@pytest.fixture(scope="module")
def wheel(hatchling: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of the checkout, with compiled code where make wheel has left it."""
    folder = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (built,) = folder.glob("*.whl")
    return built


def names(wheel: Path) -> set[str]:
    with zipfile.ZipFile(wheel) as archive:
        return set(archive.namelist())


def read(wheel: Path, pattern: str) -> str:
    (name,) = (name for name in names(wheel) if re.fullmatch(pattern, name))
    with zipfile.ZipFile(wheel) as archive:
        return archive.read(name).decode()


def test_wheel_has_every_file_that_commands_read(wheel: Path) -> None:
    packed = names(wheel)
    for file in (ROOT / "config").rglob("*"):
        if file.is_file():
            assert f"trackslip_common/config/{file.relative_to(ROOT / 'config')}" in packed
    for file in (ROOT / "src/trackslip_msgs/msg").glob("*.msg"):
        assert f"trackslip_bags/share/trackslip_msgs/msg/{file.name}" in packed
    assert {
        "trackslip/example/metadata.yaml",
        "trackslip/example/example_0.mcap",
        "trackslip/py.typed",
    } <= packed
    assert "trackslip_tools/report/templates/page.html" in packed


def test_wheel_has_every_module_except_those_of_nodes(wheel: Path) -> None:
    packed = {name for name in names(wheel) if name.endswith(".py")}
    expected = {
        str(file.relative_to(package))
        for package in ROOT.glob("src/*")
        for file in (package / package.name).rglob("*.py")
        if "nodes" not in file.parts
    }
    assert packed == expected


def test_wheel_needs_no_ros_and_all_libraries_that_its_modules_import(wheel: Path) -> None:
    text = read(wheel, r"trackslip-.*\.dist-info/METADATA")
    needed = set(re.findall(r"^Requires-Dist: ([\w-]+)", text, re.MULTILINE))
    assert f"\nVersion: {__version__}\n" in text
    assert needed >= {"numpy", "numba", "polars", "rosbags", "mcap", "bokeh"}
    assert not any(name.startswith(("ros-", "colcon")) or name == "setuptools" for name in needed)


def test_tag_of_the_wheel_is_that_of_its_machine_code(wheel: Path) -> None:
    has_code = any(name.startswith("trackslip_common/kernels/") for name in names(wheel))
    tag = re.search(r"^Tag: (\S+)$", read(wheel, r"trackslip-.*\.dist-info/WHEEL"), re.MULTILINE)
    assert tag is not None
    assert tag[1].startswith(f"cp{sys.version_info[0]}{sys.version_info[1]}-") == has_code
    assert tag[1].endswith("x86_64" if has_code else "-any")


def test_example_in_the_wheel_is_small() -> None:
    size = sum(file.stat().st_size for file in (ROOT / "bags/example").iterdir())
    assert 50_000 < size < 300_000


@pytest.fixture(scope="module")
def bare(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A new virtual environment with the wheel and its requirements only."""
    folder = tmp_path_factory.mktemp("bare")
    subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
    pip = [str(folder / "bin/python"), "-m", "pip", "install", "-q", "--prefer-binary"]
    pins = [
        f"--constraint={ROOT / name}"
        for name in ("requirements/libraries.txt", "requirements/constraints.txt")
    ]
    subprocess.run([*pip, *pins, str(wheel)], check=True)
    return folder


def run(bare: Path, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a command outside of this environment: no ROS, no checkout, no compiled code but the wheel's."""
    environment = {"PATH": f"{bare}/bin:/usr/bin:/bin", "HOME": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    environment["BROWSER"] = "true"  # opens nothing
    options = {"cwd": folder, "env": environment, "capture_output": True, "text": True}
    return subprocess.run(arguments, timeout=1200, **options)


@pytest.mark.slow
def test_commands_run_from_the_wheel_alone(bare: Path, tmp_path: Path) -> None:
    example = run(
        bare, tmp_path, "python", "-c", "import trackslip; print(trackslip.example())"
    ).stdout.strip()
    has_code = any((bare / "lib").rglob("trackslip_common/kernels"))
    replayed = run(bare, tmp_path, "trackslip", "replay", example, "--json", "own.json")
    assert replayed.returncode == 0, replayed.stderr
    assert ("compiling" in replayed.stderr) != has_code  # stated once without compiled code
    for arguments in (
        ("info", example),
        ("check", example),
        ("calibrate", example),
        ("report", example, "--output", "report.html"),
        ("demo", "--duration", "5", "--no-browser"),
        ("vehicle", "new", "--mass", "20000", "--tread", "2.4", "--no-questions"),
    ):
        done = run(bare, tmp_path, "trackslip", *arguments)
        assert done.returncode == 0, (arguments, done.stderr)
        assert "Traceback" not in done.stderr
    assert (tmp_path / "report.html").stat().st_size > 100_000
    assert (tmp_path / "trackslip_demo/report.html").is_file()
    here = tmp_path / "here.json"
    command = [sys.executable, "-m", "trackslip_tools.cli.main", "replay", example, "--json", str(here)]
    subprocess.run(command, check=True, capture_output=True)
    of_wheel, of_workspace = (json.loads((tmp_path / f"{name}.json").read_text()) for name in ("own", "here"))
    del of_wheel["real_time_factor"], of_workspace["real_time_factor"]
    assert of_wheel == of_workspace  # to the last bit: code for any processor and for this one


@pytest.mark.slow
def test_code_of_the_pages_runs_in_a_shell(bare: Path, wheel: Path, tmp_path: Path) -> None:
    (tmp_path / "dist").symlink_to(wheel.parent)
    (tmp_path / "out/demo").mkdir(parents=True)
    shutil.copytree(ROOT / "bags/slalom_sand", tmp_path / "out/demo/bag")
    write_log(tmp_path / "log.csv")
    for page in ("python", "tutorial"):
        python, done = "", run(bare, tmp_path, "true")
        for code in code_of(ROOT / f"docs/{page}.md"):
            if code.language == "yaml":
                (tmp_path / "mine.yaml").write_text(code.text, encoding="utf-8")
            elif code.language == "python":
                python += code.text
                done = run(bare, tmp_path, "python", "-c", python)
            elif not code.text.startswith(("make ", ". ")):  # these need the checkout
                done = run(bare, tmp_path, "bash", "-c", code.text)
            assert done.returncode == 0, (code, done.stderr)
    for name in (
        "trackslip_demo/report.html",
        "path.tum",
        "path.geojson",
        "out/report.html",
        "out/mine.html",
    ):
        assert (tmp_path / name).stat().st_size > 1000


@pytest.mark.slow
def test_commands_that_need_ros_name_it_where_it_is_missing(bare: Path, tmp_path: Path) -> None:
    done = run(bare, tmp_path, "trackslip", "record")
    assert done.returncode == 2
    assert "ROS is not available" in done.stderr
