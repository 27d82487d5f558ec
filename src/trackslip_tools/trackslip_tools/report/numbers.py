# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Forces and soil over time as columns, from a bag or a replay."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from trackslip_bags.tables import TopicTable
from trackslip_common.arrays import FloatArray, Rows
from trackslip_common.message_fields import SoilFields
from trackslip_common.message_reading import RecordClass, dtype_of, read

_BLOCK = 10_000  # messages collected before their conversion to rows


@dataclass(frozen=True, eq=False)
class Numbers:
    """Messages of one topic as columns."""

    times: FloatArray  # (n,) s from the bag's first message, by stamp
    rows: Rows  # (n,) records of the message's fields
    classes: dict[str, FloatArray]  # soil → (n,) its probability, nan where not compared
    reason: str  # final reason why the soil cannot be identified; empty if it can, and for forces


class NumbersCollector:
    """Collects ``Numbers`` from messages; ``start_ns``: origin of times."""

    def __init__(self, kind: RecordClass, start_ns: int) -> None:
        self._kind, self._start_ns = kind, start_ns
        self._parts = [np.empty(0, dtype_of(kind))]
        self._waiting: list[tuple[object, ...]] = []  # records
        self._classes: list[tuple[tuple[str, ...], FloatArray]] = []
        self._reason = ""

    def __len__(self) -> int:
        return sum(map(len, self._parts)) + len(self._waiting)

    def add_table(self, table: TopicTable) -> None:
        """Add the messages of a table."""
        self._parts.append(table.rows(self._kind))
        if self._kind is SoilFields:
            for k in range(len(table)):
                self._add_classes(table.message(k))

    def add(self, message: Any) -> None:
        """Add a message."""
        self._waiting.append(tuple(read(self._kind, message)))
        if self._kind is SoilFields:
            self._add_classes(message)
        if len(self._waiting) >= _BLOCK:
            self._convert_waiting()

    def numbers(self) -> Numbers:
        """The columns of all added messages."""
        self._convert_waiting()
        rows = np.concatenate(self._parts)
        times = (rows["stamp_ns"] - self._start_ns) * 1e-9
        names = sorted({name for own_names, _ in self._classes for name in own_names})
        probabilities = {name: np.full(len(rows), np.nan) for name in names}
        for k, (own_names, values) in enumerate(self._classes):
            for name, value in zip(own_names, values, strict=True):
                probabilities[name][k] = value
        return Numbers(times, rows, probabilities, self._reason)

    def _convert_waiting(self) -> None:
        self._parts.append(np.array(self._waiting, dtype=dtype_of(self._kind)))
        self._waiting.clear()

    def _add_classes(self, message: Any) -> None:
        names, values = tuple(message.class_names), np.asarray(message.class_probabilities)
        are_paired = len(names) == len(values)  # otherwise probabilities cannot be assigned
        self._classes.append((names, values) if are_paired else ((), values[:0]))
        self._reason = message.reason
