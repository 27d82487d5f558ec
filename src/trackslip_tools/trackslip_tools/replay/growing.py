# SPDX-License-Identifier: Apache-2.0
"""Records that come piece by piece, in an array that grows in place: joining parts takes twice the memory."""

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[np.void]

_FIRST, _GROWTH = 4096, 1.1  # records; share of those there are


class GrowingRows:
    """Keeps the fields of ``dtype`` of the records that are added."""

    def __init__(self, dtype: np.dtype[np.void]) -> None:
        self._rows = np.empty(_FIRST, dtype)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def add(self, more: Rows) -> None:
        """(n,) records that have at least these fields."""
        end = self._count + len(more)
        if end == self._count:
            return
        if end > len(self._rows):
            self._rows.resize(max(end, round(_GROWTH * len(self._rows))), refcheck=False)
        for name in self._rows.dtype.names or ():
            self._rows[name][self._count : end] = more[name]
        self._count = end

    def rows(self) -> Rows:
        """All of them; nothing is added after this."""
        self._rows.resize(self._count, refcheck=False)
        return self._rows
