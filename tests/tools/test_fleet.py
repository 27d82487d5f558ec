# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Many bags at once: selection, one table, results independent of the workers, and broken bags."""

import json
import multiprocessing
import os
import re
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from fixtures.commands import TRACKSLIP, json_of
from fixtures.made_bags import write_messages
from fixtures.patience import PATIENCE
from fixtures.pieces import end, refused, square, wait

from trackslip_bags.messages import make, serialize
from trackslip_bags.reader import open_bag
from trackslip_common.errors import ExitCode, InputError
from trackslip_common.vehicle_files import DEFAULT_VEHICLE_NOTE, load_vehicle, vehicle_text
from trackslip_tools.cli.main import main
from trackslip_tools.fleet.entry import Entry
from trackslip_tools.fleet.find import find_bags, is_folder, short_names
from trackslip_tools.fleet.table import text
from trackslip_tools.terminal_text import WIDTH
from trackslip_tools.workers import open_workers

ROOT = Path(__file__).parents[2]
BAGS = ROOT / "bags"
SHORT = ("--stop", "8")
_UNPRIVILEGED = 65534


@pytest.fixture
def fleet(tmp_path: Path) -> Path:
    """Two valid bags, one of them in a subfolder, and a broken one between them."""
    folder = tmp_path / "fleet"
    (folder / "c").mkdir(parents=True)
    (folder / "a").symlink_to(BAGS / "slalom_sand")
    (folder / "c" / "d").symlink_to(BAGS / "power_cut")
    (folder / "b").mkdir()
    (folder / "b" / "b_0.mcap").write_bytes(b"no bag")
    return folder


def test_folder_expands_to_its_bags(fleet: Path) -> None:
    assert is_folder(fleet)
    assert not is_folder(fleet / "b")
    assert not is_folder(fleet / "nothing")
    bags = find_bags([fleet / "c" / "d", fleet, fleet / "nothing"])
    assert [str(path.relative_to(fleet)) for path in bags] == ["c/d", "a", "b", "nothing"]


def test_a_folder_without_bags_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no bag in folder"):
        find_bags([tmp_path])


@pytest.fixture
def locked() -> Iterator[Path]:
    """A folder without permissions in a readable one; meanwhile the process has no root rights."""
    me = os.geteuid()
    with tempfile.TemporaryDirectory(dir="/tmp") as name:
        folder = Path(name, "locked")
        folder.mkdir()
        for path, mode in ((folder.parent, 0o755), (folder, 0)):
            path.chmod(mode)
        os.seteuid(_UNPRIVILEGED if me == 0 else me)
        yield folder
        os.seteuid(me)
        folder.chmod(0o700)


def test_unreadable_folder_is_named(locked: Path) -> None:
    """As with ``trackslip replay /``."""
    for path in (locked, locked.parent):
        with pytest.raises(InputError, match=f"^folder '{locked}' cannot be read .Permission denied"):
            find_bags([path])


@pytest.mark.slow
def test_number_of_workers_does_not_change_results_and_a_broken_bag_is_one_line(
    fleet: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = {count: tmp_path / f"{count}.json" for count in ("1", "2")}
    for count, file in files.items():
        options = ("--workers", count, "--json", str(file), *SHORT)
        assert main(["replay", str(fleet), *options]) == ExitCode.BAD_INPUT
    assert files["1"].read_text() == files["2"].read_text()
    entries: list[dict[str, Any]] = json.loads(files["2"].read_text())
    assert [Path(entry["bag"]).name for entry in entries] == ["a", "b", "d"]
    assert [entry["exit_code"] for entry in entries] == [ExitCode.DONE, ExitCode.BAD_INPUT, ExitCode.DONE]
    assert "cannot be read" in entries[1]["error"]
    assert entries[2]["notes"] == ["note: power_cut_0.mcap: cut short", DEFAULT_VEHICLE_NOTE]
    assert entries[0]["rmse"]["filter"] < 0.02
    printed = capsys.readouterr()
    assert "vehicles: pc05 (assumed) (2)" in printed.out
    assert [line for line in printed.out.splitlines() if len(line) > WIDTH and " " in line.strip()] == []


def test_bag_among_others_gives_the_summary_of_the_bag_alone(
    summary: Callable[..., dict[str, Any]], tmp_path: Path
) -> None:
    bag = BAGS / "slalom_sand"
    alone = summary(bag, *SHORT)
    (entry,) = json_of(tmp_path, "replay", bag, bag, "--workers", "1", *SHORT)  # duplicates replay once
    assert entry["distance"] == pytest.approx(0.36, abs=0.05)
    assert {name: entry[name] for name in alone if name != "real_time_factor"} == {
        name: value for name, value in alone.items() if name != "real_time_factor"
    }


@pytest.mark.parametrize("option", [("--output", "OUT"), ("--publish",)])
def test_options_of_one_bag_are_refused_with_several(
    option: tuple[str, ...], fleet: Path, refuse: Callable[..., str]
) -> None:
    assert "not with several bags" in refuse("replay", fleet, *option)


def test_workers_and_scheduler_exclude_each_other(fleet: Path, refuse: Callable[..., str]) -> None:
    words = refuse("replay", fleet, "--workers", "2", "--scheduler", "tcp://127.0.0.1:1")
    assert "not allowed with" in words


@pytest.mark.parametrize(
    ("command", "count"), [("replay", "0"), ("tune", "100000"), ("study", "9" * 5000), ("report", "1e3")]
)
def test_invalid_number_of_workers_is_refused_before_any_starts(
    tmp_path: Path, refuse: Callable[..., str], monkeypatch: pytest.MonkeyPatch, command: str, count: str
) -> None:
    monkeypatch.setattr(ProcessPoolExecutor, "__init__", lambda *_, **__: pytest.fail("they are started"))
    words = refuse(command, *([] if command == "study" else [tmp_path]), f"--workers={count}")
    assert re.search(
        r"--workers: '\S{1,13}' is refused; accepted: a whole number from 1 to \d+, 4 for each core", words
    )


@pytest.mark.slow
def test_a_report_of_a_folder_has_a_page_of_each_bag(fleet: Path, tmp_path: Path) -> None:
    out = tmp_path / "pages"
    (fleet / "c" / "d").unlink()
    options = ("--output", str(out), "--workers", "1", "--stop", "4")
    assert main(["report", str(fleet), *options]) == ExitCode.BAD_INPUT
    assert sorted(path.name for path in out.iterdir()) == ["1.html", "index.html"]
    index = (out / "index.html").read_text(encoding="utf-8")
    assert '<a href="1.html">a</a>' in index
    assert "cannot be read" in index


def test_hostile_names_and_errors_run_nothing_in_the_index(tmp_path: Path) -> None:
    from trackslip_tools.fleet.pages import write_pages

    hostile = "<script>alert(1)</script>"
    write_pages([Entry(f"bags/{hostile}", ExitCode.BAD_INPUT, hostile), Entry("bags/b", 0)], tmp_path)
    assert "<script" not in (tmp_path / "index.html").read_text(encoding="utf-8")


def test_an_assumed_vehicle_of_one_of_several_bags_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    vehicle = make("std_msgs/msg/String", data=vehicle_text(load_vehicle("pc05")))
    with open_bag(BAGS / "slalom_sand") as bag:
        first = ("/vehicle", vehicle.__msgtype__, bag.start_ns, serialize(vehicle))
        named = write_messages(tmp_path / "named", [first, *bag.messages()])
    bags = [str(BAGS / "slalom_sand"), str(named)]
    assert main(["replay", bags[0], "--stop", "2"]) == ExitCode.DONE
    (alone,) = [line for line in capsys.readouterr().out.splitlines() if "vehicle" in line]
    entries = json_of(tmp_path, "replay", *bags, "--stop", "2", "--workers", "1")
    printed = capsys.readouterr()
    assert "vehicles: pc05 (1), pc05 (assumed) (1)" in printed.out
    assert f"slalom_sand: {alone}" in printed.err
    assert [entry["notes"] for entry in entries] == [[alone], []]


@pytest.mark.parametrize(
    ("paths", "names"),
    [
        (["out/monday/bag", "out/tuesday/bag"], ["monday/bag", "tuesday/bag"]),
        (["bags/a", "bags/b"], ["a", "b"]),
        (["out/demo/bag"], ["bag"]),
        (["b", "a/b"], ["b", "a/b"]),
        (["/data/monday/morning/one", "/data/monday/two"], ["morning/one", "two"]),
    ],
)
def test_a_bag_is_named_by_what_distinguishes_it(paths: list[str], names: list[str]) -> None:
    assert short_names([Path(path) for path in paths]) == names


def test_the_table_names_what_is_missing_and_fits() -> None:
    entries = [
        Entry("/data/monday/morning/one", ExitCode.BAD_INPUT, "bag cannot be read"),
        Entry("/data/monday/two", ExitCode.FAILED, "no fix came", summary=SUMMARY, distance=12.34),
    ]
    shown = text(entries)
    assert "morning/one: bag cannot be read" in shown
    assert "two: no fix came" in shown
    assert "12.3" in shown
    assert "sandy loam 70 %" in shown
    assert max(map(len, shown.splitlines())) <= WIDTH


SUMMARY = {
    "duration_s": 60.0,
    "vehicle": "pc05",
    "rmse": {"filter": None},
    "nees": None,
    "nees_position": 2.5,
    "rejected": {"box_pose": {"gated": 3}, "sprockets": {"waiting": 9}},
    "soil": {"classes": {"sand": 0.3, "sandy_loam": 0.7}, "identifiable": True},
}


# Workers


def test_processes_give_results_in_order_with_one_thread_each() -> None:
    with open_workers(2, shared=100) as map_items:
        assert list(map_items(square, range(5))) == [(100 + k * k, "1") for k in range(5)]
        with pytest.raises(InputError, match="item 2 is refused"):
            list(map_items(refused, range(5)))


def test_killed_worker_is_reported_in_one_line() -> None:
    with pytest.raises(InputError, match="a process was ended"), open_workers(2) as map_items:
        list(map_items(end, range(2)))


def test_an_interruption_ends_the_processes() -> None:
    previous = signal.signal(signal.SIGALRM, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt), open_workers(2) as map_items:  # noqa: PT012
            signal.setitimer(signal.ITIMER_REAL, 2.0)
            next(map_items(wait, range(2)))
    finally:
        signal.signal(signal.SIGALRM, previous)
    for process in multiprocessing.active_children():
        process.join()
        assert process.exitcode == -signal.SIGTERM


@pytest.mark.slow
def test_worker_of_a_cluster_that_is_killed_with_the_shared_data_is_named() -> None:
    from distributed import LocalCluster

    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None, protocol="tcp") as cluster:
        (nanny,) = cluster.workers.values()
        ended = pytest.raises(InputError, match="its workers ended")
        with open_workers(1, cluster.scheduler_address, shared=nanny.pid) as map_items, ended:
            list(map_items(os.kill, [signal.SIGKILL]))  # shared is the pid of the worker's process


def test_ctrl_c_of_a_terminal_leaves_no_process_and_no_traceback(fleet: Path) -> None:
    """Ctrl-C reaches all processes of the group."""
    command = [*TRACKSLIP, "replay", str(fleet), "--workers", "2"]
    process = subprocess.Popen(command, start_new_session=True, stderr=subprocess.PIPE, text=True)
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    while len(children.read_text().split()) < 2:  # the first worker and the resource tracker
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    _, error = process.communicate(timeout=PATIENCE)
    assert "Traceback" not in error
    assert process.returncode == ExitCode.INTERRUPTED
