# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Records that are added in pieces to an array that grows in place: joining parts takes twice the memory."""

import numpy as np

from trackslip_common.arrays import Rows

MOST_DRAWN = 300_000  # records kept for plots, not for scores: 50 min of 100 Hz
_FIRST, _GROWTH = 4096, 1.1  # records; factor of growth


class GrowingRows:
    """Keeps the fields of ``dtype`` of added records: all records, or at most ``most``, evenly spread."""

    def __init__(self, dtype: np.dtype[np.void], most: int | None = None) -> None:
        self._rows = np.empty(_FIRST, dtype)
        self._count, self._most = 0, most
        self._seen, self._stride = 0, 1  # number of added records; step between kept ones

    def __len__(self) -> int:
        return self._count

    def add(self, more: Rows) -> None:
        """Add (n,) records that have at least these fields."""
        kept = more[-self._seen % self._stride :: self._stride]
        self._seen += len(more)
        end = self._count + len(kept)
        if end == self._count:
            return
        if end > len(self._rows):
            self._rows.resize(max(end, round(_GROWTH * len(self._rows))), refcheck=False)
        for name in self._rows.dtype.names or ():
            self._rows[name][self._count : end] = kept[name]
        self._count = end
        while self._most is not None and self._count > self._most:
            half = self._rows[: self._count : 2].copy()
            self._count, self._stride = len(half), 2 * self._stride
            self._rows[: self._count] = half

    def rows(self) -> Rows:
        """All kept records; nothing may be added afterwards."""
        self._rows.resize(self._count, refcheck=False)
        return self._rows
