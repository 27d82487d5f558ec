# SPDX-License-Identifier: Apache-2.0
"""Topics of a bag as columns, read once: they are kept in the user's cache for the next run.

A kept file is found by the bag's files (place, size, time of change) and the topics in it, so it is never
that of another bag or state of it. Where the cache cannot be used the bag is read, and nothing is said.
"""

import hashlib
import os
import tempfile
import zipfile
from collections.abc import Collection, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_bags.chunks import by_topic
from trackslip_bags.columns import Columns, columns_of
from trackslip_bags.reader import Bag

_VERSION = 1  # of what is kept
_FILES = 64  # kept at the most; the oldest go first
_ORDER, _TIME = "/order", "/log_time"


class TopicColumns(NamedTuple):
    """All messages of one topic, in log order."""

    order: NDArray[np.int64]  # (n,) their places among the messages of all topics that were asked for
    log_times_ns: NDArray[np.int64]  # (n,)
    columns: Columns

    def between(self, start_ns: int | None, stop_ns: int | None) -> "TopicColumns":
        """Messages logged from ``start_ns`` on and before ``stop_ns``; None for no limit."""
        first, last = (
            default if t is None else int(np.searchsorted(self.log_times_ns, t))
            for t, default in ((start_ns, 0), (stop_ns, len(self.order)))
        )
        inside = slice(first, last)
        columns = {name: column[inside] for name, column in self.columns.items()}
        return TopicColumns(self.order[inside], self.log_times_ns[inside], columns)


def read_columns(bag: Bag, topics: Collection[str]) -> dict[str, TopicColumns]:
    """The topics, as the bag names them, whole; those without messages are left out.

    Raises:
        InputError: the bag is damaged inside.
        IrregularError: a topic makes no columns.
    """
    file = _kept(bag, topics)
    if file is not None:
        with suppress(OSError, ValueError, KeyError, zipfile.BadZipFile), np.load(file) as arrays:
            return _unpacked(arrays)
    found = _read(bag, topics)
    if file is not None:
        with suppress(OSError):
            _keep(file, found)
    return found


def _read(bag: Bag, topics: Collection[str]) -> dict[str, TopicColumns]:
    found = {}
    for topic, (order, log_times_ns, raws) in by_topic(bag, topics).items():
        type_name = bag.topics[topic].type_name
        columns = columns_of(bag.store(type_name), type_name, raws)
        found[topic] = TopicColumns(order, log_times_ns, columns)
    return found


def cache_directory() -> Path:
    """Where columns are kept: XDG_CACHE_HOME, or ~/.cache."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "trackslip" / "columns"


def _kept(bag: Bag, topics: Collection[str]) -> Path | None:
    """The file that holds these topics, or will; None where there can be none."""
    try:
        path = bag.path.resolve()
        files = sorted(path.iterdir()) if path.is_dir() else [path]
        states = [(str(file), file.stat().st_size, file.stat().st_mtime_ns) for file in files]
        name = hashlib.sha256(repr((_VERSION, states, sorted(topics))).encode()).hexdigest()[:32]
        return cache_directory() / f"{name}.npz"
    except (OSError, RuntimeError):  # RuntimeError: there is no home directory
        return None


def _keep(file: Path, found: Mapping[str, TopicColumns]) -> None:
    """Whole or not at all: another process may be reading."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=file.parent, suffix=".tmp", delete=False) as part:
        try:
            np.savez(part, **_packed(found))  # type: ignore[arg-type]
        except BaseException:
            Path(part.name).unlink()
            raise
    Path(part.name).replace(file)
    kept = sorted(file.parent.glob("*.npz"), key=lambda other: other.stat().st_mtime)
    for old in kept[:-_FILES]:
        old.unlink(missing_ok=True)


def _packed(found: Mapping[str, TopicColumns]) -> dict[str, NDArray[Any]]:
    packed: dict[str, NDArray[Any]] = {}
    for topic, (order, log_times_ns, columns) in found.items():
        packed |= {f"{topic}:{_ORDER}": order, f"{topic}:{_TIME}": log_times_ns}
        packed |= {f"{topic}:{name}": column for name, column in columns.items()}
    return packed


def _unpacked(arrays: Mapping[str, NDArray[Any]]) -> dict[str, TopicColumns]:
    topics: dict[str, dict[str, NDArray[Any]]] = {}
    for key in arrays:
        topic, _, name = key.rpartition(":")
        topics.setdefault(topic, {})[name] = arrays[key]
    return {topic: TopicColumns(of.pop(_ORDER), of.pop(_TIME), of) for topic, of in topics.items()}
