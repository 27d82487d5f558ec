# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Serializes many messages of one type from columns of numbers, or fills a live message from one row.

Messages of a topic differ only in numbers. Strings and lengths of sequences are those of a blank message, so
each field has the same position in the bytes of all messages.
"""

import functools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_bags.messages import serialize
from trackslip_bags.types import ensure_type, fields_by
from trackslip_common.layout import Layout
from trackslip_common.units import NS_PER_S

Columns = Mapping[str, NDArray[Any]]
"""Dotted name of a field → (n,) its values, or (n, k) where it holds k of them."""


def stamp_columns(stamps_ns: Sequence[int]) -> Columns:
    """Columns of a header's stamp."""
    sec, nanosec = np.divmod(np.array(stamps_ns, dtype=np.int64), NS_PER_S)
    return {"header.stamp.sec": sec, "header.stamp.nanosec": nanosec}


def set_fields(message: Any, columns: Columns) -> None:
    """Set fields of a message from the first row of each column; scalar fields only."""
    for name, column in columns.items():
        *path, field = name.split(".")
        setattr(functools.reduce(getattr, path, message), field, column[0].item())


class MessageColumns:
    """Serializer of messages like ``blank``, which ``trackslip_bags.messages.make`` has made."""

    def __init__(self, blank: Any) -> None:
        self._blank = serialize(blank)
        type_name = blank.__msgtype__
        self._fields = Layout(fields_by(ensure_type(type_name)), type_name, self._blank).dtype

    def serialize(self, columns: Columns) -> list[bytes]:
        """CDR of the blank with the values of each row: one message per row."""
        (count,) = {len(column) for column in columns.values()}
        size = len(self._blank)
        rows = np.frombuffer(self._blank * count, dtype=np.uint8).copy()
        fields = rows.view(self._fields)
        for name, column in columns.items():
            fields[name] = column
        whole = rows.tobytes()
        return [whole[begin : begin + size] for begin in range(0, len(whole), size)]
