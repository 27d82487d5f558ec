# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Opens SQLite files of bags with the transactions in their ``-wal`` or ``-journal`` files.

rosbags opens a database as immutable, in which case SQLite ignores these files. A killed recorder in WAL mode
(rosbag2's preset ``resilient``) leaves its latest messages there.
"""

from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import quote

from rosbags.rosbag2 import storage_sqlite3

_COMPANIONS = ("-wal", "-journal")
_NAME = "apsw"  # the binding that rosbags uses
_SQLITE: Any = getattr(storage_sqlite3, _NAME)
_PREFIX, _IMMUTABLE = "file:", "?immutable=1"  # of the URI that rosbags uses
MAGIC = b"SQLite format 3\0"


def database_uri(path: Path) -> str:
    """The URI that opens a database for reading.

    Without companion files the database opens as immutable, which works on read-only media.
    """
    beside = (path.with_name(path.name + ending) for ending in _COMPANIONS)
    has_companion = any(file.is_file() and file.stat().st_size for file in beside)
    return f"{_PREFIX}{quote(str(path.absolute()))}{'?mode=ro' if has_companion else _IMMUTABLE}"


def use_companion_files() -> None:
    """Make rosbags open databases by ``database_uri``."""
    names = {**vars(_SQLITE), "Connection": _connection}
    setattr(storage_sqlite3, _NAME, SimpleNamespace(**names))


def _connection(uri: str, flags: int, vfs: str | None = None) -> Any:
    path = Path(uri.removeprefix(_PREFIX).removesuffix(_IMMUTABLE))
    connection = _SQLITE.Connection(database_uri(path), flags=flags, vfs=vfs)
    try:
        connection.execute("SELECT count(*) FROM sqlite_master")
    except _SQLITE.ReadOnlyError as error:
        connection.close()
        raise ValueError(
            f"{path.name}: an unfinished transaction beside it ({error}); copy the bag to where it may be "
            f"written and run: sqlite3 {path.name} 'PRAGMA integrity_check'"
        ) from error
    except _SQLITE.CantOpenError as error:
        connection.close()
        raise ValueError(
            f"{path.name}: its -wal cannot be read here ({error}); copy the bag to where it may be written"
        ) from error
    except BaseException:
        connection.close()
        raise
    return connection
