# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Forces and soil over time as columns, from a bag or a replay."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trackslip_bags.tables import TopicTable
from trackslip_common.arrays import FloatArray, Rows
from trackslip_common.message_fields import SoilFields
from trackslip_common.message_reading import RecordClass, dtype_of
from trackslip_tools.report.quantities import classes_of


@dataclass(frozen=True, eq=False)
class Numbers:
    """Messages of one topic as columns."""

    times: FloatArray  # (n,) s from the bag's first message, by stamp
    rows: Rows  # (n,) records of the message's fields
    classes: dict[str, FloatArray]  # soil → (n,) its probability, nan where not compared
    reason: str  # final reason why the soil cannot be identified; empty if it can, and for forces

    def classes_at(self, k: int) -> dict[str, float]:
        """Soil → probability in message ``k``, of the soils that were compared."""
        return {name: float(p[k]) for name, p in self.classes.items() if np.isfinite(p[k])}


def make_numbers(
    rows: Rows, start_ns: int, classes: Sequence[Mapping[str, float]] = (), reason: str = ""
) -> Numbers:
    """Columns of (n,) records; ``start_ns``: origin of times; ``classes``: soil → probability of each."""
    names = sorted({name for of_record in classes for name in of_record})
    columns = {name: np.array([of_record.get(name, np.nan) for of_record in classes]) for name in names}
    return Numbers((rows["stamp_ns"] - start_ns) * 1e-9, rows, columns, reason)


class NumbersCollector:
    """Collects ``Numbers`` from the tables of a bag; ``start_ns``: origin of times."""

    def __init__(self, kind: RecordClass, start_ns: int) -> None:
        self._kind, self._start_ns = kind, start_ns
        self._parts = [np.empty(0, dtype_of(kind))]
        self._classes: list[dict[str, float]] = []
        self._reason = ""

    def __len__(self) -> int:
        return sum(map(len, self._parts))

    def add(self, table: TopicTable) -> None:
        """Add the messages of a table."""
        self._parts.append(table.rows(self._kind))
        for message in map(table.message, range(len(table)) if self._kind is SoilFields else ()):
            self._classes.append(classes_of(message))
            self._reason = message.reason

    def numbers(self) -> Numbers:
        """The columns of all added messages."""
        return make_numbers(np.concatenate(self._parts), self._start_ns, self._classes, self._reason)
