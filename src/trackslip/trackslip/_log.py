# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Contents of a bag: topics as columns."""

from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip._estimates import to_pandas
from trackslip._values import as_text
from trackslip_bags.parameters import bag_vehicle
from trackslip_bags.reader import absolute_name, open_bag, require_topics
from trackslip_bags.tables import read_tables
from trackslip_common.errors import InputError
from trackslip_common.message_fields import RECORDS


@dataclass(frozen=True, eq=False)
class Log:
    """Overview of a bag; topics are read on request."""

    path: Path
    namespace: str
    start_ns: int  #: log time of the first message
    duration: float  #: s, from the first to the last message
    topics: dict[str, int]  #: name → number of messages
    types: dict[str, str]  #: name → type
    vehicle: str | None  #: name of the vehicle in the bag
    damage: str  #: description of the damage; empty without damage

    def columns(self, topic: str) -> dict[str, NDArray[Any]]:
        """Name → (n,) or (n, …) column of a topic, ``log_time_ns`` first; SI units.

        Raises:
            InputError: there is no such topic, or its type is not supported.
        """
        topic = as_text("topic", topic)
        with open_bag(self.path, self.namespace) as bag:
            require_topics(bag, [topic])
            type_name = self.types[absolute_name(topic)]
            kind = RECORDS.get(type_name)
            if kind is None:
                readable = [name for name, kind_name in self.types.items() if kind_name in RECORDS]
                raise InputError(
                    f"bag '{self.path}': {topic} is a {type_name}, which has no columns; "
                    f"accepted: {', '.join(readable)}"
                )
            tables = [table for stretch in read_tables(bag, [topic]) for table in stretch.values()]
            rows = np.concatenate([table.rows(kind) for table in tables])
            times = np.concatenate([table.log_times_ns for table in tables])
        return {"log_time_ns": times, **{name: rows[name] for name in rows.dtype.names or ()}}

    def to_pandas(self, topic: str) -> Any:
        """The topic's columns with one number per message, as a ``pandas.DataFrame``.

        Raises:
            InputError: as ``columns``, or pandas is not installed.
        """
        columns = self.columns(topic).items()
        return to_pandas({name: column for name, column in columns if column.ndim == 1})


def load(bag: Path | str, namespace: str = "") -> Log:
    """An overview of a bag: topics, duration, vehicle.

    Raises:
        InputError: it cannot be read.
    """
    path, name = Path(as_text("bag", bag)), as_text("namespace", namespace)
    with open_bag(path, name) as opened:
        topics = {absolute_name(topic): info for topic, info in sorted(opened.topics.items())}
        vehicle = bag_vehicle(opened)
        return Log(
            path,
            name,
            opened.start_ns,
            opened.duration_s,
            {topic: info.count for topic, info in topics.items()},
            {topic: info.type_name for topic, info in topics.items()},
            None if vehicle is None else vehicle.name,
            opened.damage,
        )


def example() -> Path:
    """A short bag of this package: an emulated excavator of 20 t drives a slalom, with RTK GNSS."""
    return Path(str(files(__package__))) / "example"
