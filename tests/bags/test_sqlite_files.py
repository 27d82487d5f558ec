# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""SQLite bags are read with the companion files of their database, as by SQLite."""

import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path

import pytest
from fixtures.made_bags import IMU, MS, imu, write_foreign

from trackslip_bags.reader import open_bag
from trackslip_bags.recovery.recover import recover
from trackslip_common.errors import ExitCode, InputError
from trackslip_tools.cli.main import main

COUNT = 300


def written(path: Path, count: int) -> Path:
    """Write the database of a bag with another recorder; return its path."""
    write_foreign(path, (("/imu", IMU, i * 10 * MS, imu(i * 10 * MS)) for i in range(count)))
    (path / "metadata.yaml").unlink()
    return path / f"{path.name}.db3"


def killed(tmp_path: Path, journal_mode: str, before: int) -> Path:
    """A bag of a killed recorder: ``before`` messages in the database, the rest in its companion file."""
    file = written(tmp_path / "recording", before)
    bag = tmp_path / "bag"
    database = sqlite3.connect(file, isolation_level=None)
    database.execute(f"PRAGMA journal_mode={journal_mode}")
    database.execute("PRAGMA wal_autocheckpoint=0")
    database.execute("PRAGMA cache_size=1")  # changes are written before the transaction ends
    database.execute("BEGIN")
    for i in range(before, COUNT):
        row = (1, i * 10 * MS, imu(i * 10 * MS))
        database.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", row)
    if journal_mode == "WAL":
        database.execute("COMMIT")
    shutil.copytree(file.parent, bag)
    database.close()
    assert {path.suffix for path in bag.iterdir()} > {".db3"}
    return bag


@pytest.mark.parametrize("before", [1, COUNT // 2])
@pytest.mark.parametrize("keeps_index", [True, False])
def test_messages_in_the_write_ahead_log_are_read(tmp_path: Path, before: int, keeps_index: bool) -> None:
    bag = killed(tmp_path, "WAL", before)
    if not keeps_index:
        next(bag.glob("*-shm")).unlink()
    database = next(bag.glob("*.db3"))
    content = database.read_bytes()
    with open_bag(bag) as opened:
        assert opened.message_count == COUNT
        assert [message.raw for message in opened.messages()] == [imu(i * 10 * MS) for i in range(COUNT)]
    assert recover(bag, tmp_path / "out").messages == COUNT
    assert database.read_bytes() == content


def test_hot_journal_is_never_ignored(tmp_path: Path) -> None:
    """The database holds half a transaction; only the journal can undo it."""
    bag = killed(tmp_path, "DELETE", 100)
    with pytest.raises(InputError, match="unfinished transaction"):
        open_bag(bag)


@pytest.mark.parametrize("name", ["a?b", "a#b", "a%20b", "a b"])
def test_a_database_opens_whatever_its_name(tmp_path: Path, name: str) -> None:
    file = written(tmp_path / "bag", 5)
    with open_bag(file.rename(tmp_path / f"{name}.db3")) as opened:
        assert opened.message_count == 5


@pytest.mark.parametrize("command", ["info", "recover", "replay"])
def test_truncated_database_is_refused_with_the_message_of_sqlite(
    tmp_path: Path, command: str, refuse: Callable[..., str]
) -> None:
    file = written(tmp_path / "bag", COUNT)
    file.write_bytes(file.read_bytes()[: file.stat().st_size * 6 // 10])
    for path in (file, file.parent):
        assert "malformed" in refuse(command, path)


def test_recover_that_saves_nothing_fails(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "bag_0.mcap").write_bytes(b"\x89MCAP0\r\n")
    assert main(["recover", str(tmp_path / "bag")]) == ExitCode.FAILED
    assert "saved: nothing" in capsys.readouterr().out
