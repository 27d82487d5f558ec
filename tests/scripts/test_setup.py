# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""State and commands of ``make setup``: damage and interruption leave nothing half done."""

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from fixtures.patience import PATIENCE, wait_for

import setup_commands
import setup_environment
import setup_workspace
from setup_commands import Command, SetupError, in_parallel, read_stamp, run, write_file


@pytest.fixture(autouse=True)
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A log file for one test."""
    path = tmp_path / "setup.log"
    path.touch()
    monkeypatch.setattr(setup_commands, "LOG", path)
    return path


@pytest.mark.parametrize("content", [None, b"", b'{"digest": "12', b"[1, 2]", b"\0\0\0", b"\xff\xfe\x00"])
def test_absent_or_damaged_stamp_reads_as_none(content: bytes | None, tmp_path: Path) -> None:
    stamp = tmp_path / "stamp.json"
    if content is not None:
        stamp.write_bytes(content)
    assert read_stamp(stamp) == {}


def test_stamp_reads_as_written(tmp_path: Path) -> None:
    setup_commands.write_stamp(tmp_path / "stamp.json", "12ab", "kilted")
    assert read_stamp(tmp_path / "stamp.json") == {"digest": "12ab", "ros": "kilted"}


def test_write_that_fails_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "stamp.json"
    write_file(path, json.dumps({"digest": "old"}))
    with pytest.raises(UnicodeEncodeError):
        write_file(path, '{"digest": "\ud800"}')
    assert read_stamp(path) == {"digest": "old"}


def test_failed_command_shows_the_end_of_its_output(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SetupError, match="failed; the whole output is in"):
        run(Command([sys.executable, "-c", "import sys; sys.exit('this went wrong')"]))
    assert "this went wrong" in capsys.readouterr().err


def runs(pid: Path) -> bool:
    """Whether the process with the number in a file runs, and is no zombie."""
    try:
        state = Path("/proc", pid.read_text().strip(), "stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


@pytest.mark.parametrize("in_the_block", [False, True])
def test_failed_command_ends_those_beside_it(tmp_path: Path, in_the_block: bool) -> None:
    pid = tmp_path / "pid"
    sleeping = Command(["sh", "-c", f"echo $$ > {pid}; exec sleep 600"])
    failing = Command(["sh", "-c", f"until [ -s {pid} ]; do sleep 0.01; done; exit 1"])

    def work() -> None:
        with in_parallel([sleeping] if in_the_block else [sleeping, failing]):
            if in_the_block:
                run(failing)

    with pytest.raises(SetupError):
        work()
    assert not runs(pid)


def test_block_waits_for_its_parallel_commands(tmp_path: Path) -> None:
    with in_parallel([Command(["sh", "-c", f"sleep 0.2; touch {tmp_path / name}"]) for name in "ab"]):
        (tmp_path / "c").touch()
    assert {path.name for path in tmp_path.iterdir()} >= {"a", "b", "c"}


def test_interrupted_set_up_ends_all_it_started(tmp_path: Path) -> None:
    """SIGTERM, for example from a cancelled CI job: no pip keeps writing during the next run."""
    program = f"""
import sys
sys.path.insert(0, {str(Path(setup_commands.__file__).parent)!r})
import pathlib, setup_commands
setup_commands.note_interrupts()
setup_commands.LOG = pathlib.Path({str(tmp_path / "setup.log")!r})
setup_commands.run(setup_commands.Command(
    ["sh", "-c", "sleep 600 & cd {tmp_path}; echo $! > new; mv new pid; wait"]))
"""
    process = subprocess.Popen([sys.executable, "-c", program], stderr=subprocess.DEVNULL)
    pid = tmp_path / "pid"
    wait_for(lambda: pid.is_file() and runs(pid))
    process.send_signal(signal.SIGTERM)
    process.wait(PATIENCE)
    wait_for(lambda: not runs(pid))


def choose(requested: str, before: str, monkeypatch: pytest.MonkeyPatch, **environment: str) -> str:
    """The distribution that ``choose_ros`` selects, with an earlier stamp and variables of the shell."""
    for name in ("ROS_DISTRO", "AMENT_PREFIX_PATH"):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(setup_workspace, "read_stamp", lambda _: {"ros": before} if before else {})
    return setup_workspace.choose_ros(requested)


def test_jazzy_is_the_default(monkeypatch: pytest.MonkeyPatch) -> None:
    assert choose("", "", monkeypatch) == "jazzy"
    assert choose("", "kilted", monkeypatch) == "kilted"
    assert choose("kilted", "jazzy", monkeypatch) == "kilted"


def test_own_environment_is_not_taken_for_a_ros_from_apt(monkeypatch: pytest.MonkeyPatch) -> None:
    prefixes = os.pathsep.join(["/some/package", str(setup_environment.VENV)])
    chosen = choose("kilted", "jazzy", monkeypatch, ROS_DISTRO="jazzy", AMENT_PREFIX_PATH=prefixes)
    assert chosen == "kilted"


@pytest.mark.parametrize(("requested", "before"), [("lyrical", ""), ("", "system")])
def test_unavailable_ros_distribution_is_refused(
    requested: str, before: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(SetupError):
        choose(requested, before, monkeypatch)


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A checkout where ``set_up`` makes a ``.venv`` of one file."""
    venv, workspace = tmp_path / ".venv", tmp_path / "ros2_ws"
    for module in (setup_environment, setup_workspace):
        monkeypatch.setattr(module, "VENV", venv)
        monkeypatch.setattr(module, "VENV_STAMP", venv / "trackslip.json")
        monkeypatch.setattr(module, "WORKSPACE", workspace)
    monkeypatch.setattr(setup_workspace, "WORKSPACE_STAMP", workspace / "install" / ".trackslip.json")
    monkeypatch.setattr(setup_workspace, "choose_ros", lambda asked: asked or "jazzy")
    monkeypatch.setattr(setup_workspace, "install_system_packages", lambda: None)
    monkeypatch.setattr(setup_workspace, "create_venv", lambda _: (venv / "made").touch())
    monkeypatch.setattr(setup_workspace, "kernel_compilation", list)
    monkeypatch.setattr(setup_workspace, "install_ros", lambda _: None)
    monkeypatch.setattr(
        setup_workspace, "build_workspace", lambda _: (workspace / "install").mkdir(parents=True)
    )
    monkeypatch.setattr(setup_workspace, "install_environment", lambda _: None)
    return venv


@pytest.mark.parametrize("kind", ["environment", "file", "link to nothing"])
def test_foreign_environment_is_refused_and_kept(checkout: Path, kind: str) -> None:
    """For example a user's own ``python3 -m venv .venv`` in the checkout."""
    if kind == "environment":
        checkout.mkdir()
        (checkout / "pyvenv.cfg").write_text("mine")
    elif kind == "file":
        checkout.write_text("mine")
    else:
        checkout.symlink_to("nowhere")
    before = sorted(checkout.parent.rglob("*"))
    with pytest.raises(SetupError, match="was not made by make setup, and stays; move it away") as refused:
        setup_workspace.set_up("", checks=False)
    assert "\n" not in str(refused.value)
    assert sorted(checkout.parent.rglob("*")) == before


@pytest.mark.parametrize("stamp", [None, "", "{", '{"digest": "of before", "ros": "jazzy"}'])
def test_own_environment_with_a_damaged_stamp_is_replaced(checkout: Path, stamp: str | None) -> None:
    (checkout / "lib").mkdir(parents=True)
    (checkout / "lib64").symlink_to("lib")
    (checkout / "trackslip.sh").touch()
    if stamp is not None:
        (checkout / "trackslip.json").write_text(stamp)
    setup_workspace.set_up("", checks=False)
    assert sorted(path.name for path in checkout.iterdir()) == ["made", "trackslip.json"]
    (checkout / "more").touch()
    setup_workspace.set_up("", checks=False)
    assert (checkout / "more").exists()  # no change since


@pytest.mark.parametrize("left", [[], ["trackslip.json.part"]])
def test_set_up_resumes_a_new_environment(checkout: Path, left: list[str]) -> None:
    checkout.mkdir()
    for name in left:
        (checkout / name).touch()
    setup_workspace.set_up("", checks=False)
    assert sorted(path.name for path in checkout.iterdir()) == ["made", "trackslip.json"]


CREATING = ("removing", "install_system_packages", "create_venv", "install_ros")


@pytest.mark.parametrize("step", [*CREATING, "build_workspace"])
def test_set_up_resumes_after_an_interruption_at_any_step(
    checkout: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    """Also after kill -9, as if no later step had run."""

    def end(*_: object) -> None:
        (checkout / "half").touch()
        raise KeyboardInterrupt

    (checkout / "lib").mkdir(parents=True)
    (checkout / "trackslip.json").touch()
    with monkeypatch.context() as patch:
        where = (shutil, "rmtree") if step == "removing" else (setup_workspace, step)
        patch.setattr(*where, end)
        with pytest.raises(KeyboardInterrupt):
            setup_workspace.set_up("", checks=False)
    setup_workspace.set_up("", checks=False)
    remaining = {"half"} if step == "build_workspace" else set()  # .venv is complete
    assert {path.name for path in checkout.iterdir()} == {"made", "trackslip.json"} | remaining
    assert read_stamp(checkout / "trackslip.json")["digest"]


def test_directory_that_cannot_be_removed_is_named(checkout: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (checkout / "lib").mkdir(parents=True)
    (checkout / "trackslip.json").touch()

    def refuses(path: Path) -> None:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(shutil, "rmtree", refuses)
    with pytest.raises(SetupError, match=r"lib cannot be replaced \(Permission denied\)"):
        setup_workspace.set_up("", checks=False)


def test_make_clean_keeps_a_foreign_environment(tmp_path: Path) -> None:
    makefile = Path(setup_commands.ROOT, "Makefile")
    for name, remains in (("pyvenv.cfg", True), ("trackslip.json", False)):
        (tmp_path / ".venv" / "bin").mkdir(parents=True, exist_ok=True)
        (tmp_path / ".venv" / name).touch()
        subprocess.run(["make", "-f", makefile, "clean"], cwd=tmp_path, check=True, capture_output=True)
        assert (tmp_path / ".venv").exists() == remains
        (tmp_path / ".venv" / name).unlink(missing_ok=True)
