# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Dead reckoning beside a replay: started at the reference's first pose, scored, kept for plots."""

import numpy as np

from trackslip_common.arrays import Rows
from trackslip_common.vehicle import Kinematics
from trackslip_tools.replay.dead_reckoning import DeadReckoner, Path
from trackslip_tools.replay.errors import PathErrors
from trackslip_tools.replay.growing import MOST_DRAWN, GrowingRows
from trackslip_tools.replay.scoring import Score

_PATH = np.dtype([("stamp_ns", np.int64), ("pose", np.float64, (3,))])


class Reckoning:
    """One dead-reckoned path; the path is thinned for plots, the score uses all of it."""

    def __init__(self, vehicle: Kinematics, *, with_gyro: bool) -> None:
        self._reckoner = DeadReckoner(vehicle, with_gyro=with_gyro)
        self._errors, self._drawn = PathErrors(), GrowingRows(_PATH, MOST_DRAWN)
        self._early_reference: list[Rows] | None = []  # reference rows until the start

    @property
    def first_ns(self) -> int | None:
        """Stamp of the first sprocket sample."""
        return self._reckoner.first_ns

    def add(self, arrivals: Rows, reference: Rows | None) -> None:
        """Add both; rows of the reference have stamp_ns, x, y, heading."""
        self._reckoner.add(arrivals)
        if self._early_reference is not None:
            self._early_reference += [] if reference is None else [reference]
            self._begin(self._early_reference)
        self._extend(self._reckoner.advance(), reference)

    def result(self) -> tuple[Path | None, Score | None]:
        """Path and score after the last piece."""
        self._extend(self._reckoner.advance(whole=True), None)
        rows = self._drawn.rows()
        return (Path(rows["stamp_ns"], rows["pose"]) if len(rows) else None), self._errors.score

    def _begin(self, pieces: list[Rows]) -> None:
        """Start at the first reference pose with a heading at or after the first sprocket sample."""
        first_ns = self.first_ns
        if first_ns is None or not pieces:
            return
        reference = np.concatenate(pieces)
        later = reference[(reference["stamp_ns"] >= first_ns) & np.isfinite(reference["heading"])]
        if len(later):
            start = later[np.argmin(later["stamp_ns"])]
            pose = np.array([start[name] for name in ("x", "y", "heading")])
            self._reckoner.begin(int(start["stamp_ns"]), pose)
            self._early_reference = None

    def _extend(self, path: Path | None, reference: Rows | None) -> None:
        nothing = Path(np.empty(0, np.int64), np.empty((0, 3)))
        self._errors.add(path or nothing, reference)
        if path is not None:
            rows = np.empty(len(path.stamps_ns), _PATH)
            rows["stamp_ns"], rows["pose"] = path.stamps_ns, path.poses
            self._drawn.add(rows if not len(self._drawn) else rows[1:])
