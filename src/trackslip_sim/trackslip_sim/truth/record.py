# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The uniformly sampled true motion of a run; it scores estimators and is never their input."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from trackslip_common.arrays import FloatArray, IntArray

WINDOW_LENGTH = 20.0  # s, length of the past that remains available
_AHEAD = 3  # samples: derivatives at the two samples about a time need one more


@dataclass(frozen=True, eq=False, kw_only=True)
class Truth:
    """Arrays (n,) over time; SI units, site frame ``odom`` and body frame base_link (C, x forward).

    Angles are continuous. A slip is 0 while its track runs slower than the settings' ``slip_floor``,
    where 1 - v/(r ω) is undefined; the slip angle is 0 while |v_x| is below the same speed.
    """

    t: FloatArray  # s, from 0
    x: FloatArray  # m
    y: FloatArray  # m
    z: FloatArray  # m, up; 0 at the start
    yaw: FloatArray  # rad, ZYX as pitch and roll (REP-103): pitch nose down, roll left side up
    pitch: FloatArray  # rad
    roll: FloatArray  # rad
    v_x: FloatArray  # m/s, at C in the body frame: along the ground
    v_y: FloatArray  # m/s
    roll_rate: FloatArray  # rad/s, in the body frame: about x
    pitch_rate: FloatArray  # about y
    yaw_rate: FloatArray  # about z, the normal of the ground
    left_angle: FloatArray  # rad, sprocket
    right_angle: FloatArray
    left_speed: FloatArray  # rad/s, sprocket
    right_speed: FloatArray
    left_slip: FloatArray  # 1
    right_slip: FloatArray
    slip_angle: FloatArray  # rad, atan(v_y / v_x)
    left_thrust: FloatArray  # N, of the soil on the track
    right_thrust: FloatArray
    left_resistance: FloatArray  # N, opposite to motion; sign of v_j
    right_resistance: FloatArray
    left_load: FloatArray  # N, normal to the ground
    right_load: FloatArray
    turning_moment: FloatArray  # N m, of lateral shear; positive opposes the yaw rate (M_r)
    left_pressure: FloatArray  # Pa, differential, positive drives forward
    right_pressure: FloatArray
    left_spool: FloatArray  # -1 … 1
    right_spool: FloatArray
    supply_pressure: FloatArray  # Pa
    swing: FloatArray  # rad, upper structure against undercarriage, counter-clockwise, continuous
    swing_rate: FloatArray  # rad/s
    soil_index: IntArray  # of the soil under C, into ``soil_names``
    soil_names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.t)

    @property
    def duration(self) -> float:
        """Time of the last sample, s."""
        return float(self.t[-1])

    def soil_name(self, index: int = -1) -> str:
        """Name of the soil under C at one sample."""
        return self.soil_names[int(self.soil_index[index])]

    def samples_since(self, t: float) -> Truth:
        """The samples from time ``t``, s, on, and the one before them."""
        first = max(0, int(np.searchsorted(self.t, t)) - 1)
        columns = {name: getattr(self, name)[first:] for name in COLUMNS}
        return Truth(**columns, soil_index=self.soil_index[first:], soil_names=self.soil_names)

    def interpolate(self, times: ArrayLike) -> Truth:
        """The truth at the given times (m,), or at one time, s: linear between samples, held beyond the ends.

        The soil is that of the previous sample.
        """
        t = np.atleast_1d(np.asarray(times, dtype=np.float64))
        before = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.t) - 1)
        columns = {name: np.interp(t, self.t, getattr(self, name)) for name in COLUMNS}
        columns["t"] = t
        return Truth(**columns, soil_index=self.soil_index[before], soil_names=self.soil_names)


COLUMNS = tuple(
    field.name for field in dataclasses.fields(Truth) if field.name not in ("soil_index", "soil_names")
)


def join_pieces(pieces: Sequence[Truth]) -> Truth:
    """Consecutive pieces of one run as one record."""
    if len(pieces) == 1:
        return pieces[0]
    columns = {name: np.concatenate([getattr(piece, name) for piece in pieces]) for name in COLUMNS}
    soil_index = np.concatenate([piece.soil_index for piece in pieces])
    return Truth(**columns, soil_index=soil_index, soil_names=pieces[0].soil_names)


class TruthWindow:
    """Sliding window over one drive: pieces are computed on demand and dropped after ``WINDOW_LENGTH`` s.

    Attributes:
        truth: the record within the window.
        duration: duration of the whole drive, s.
    """

    def __init__(self, pieces: Iterable[Truth], duration: float) -> None:
        self._pieces = iter(pieces)
        self.duration = duration
        self._set_truth(next(self._pieces))

    def advance(self, t: float) -> bool:
        """Advance the window to time ``t``, s; return whether ``truth`` changed."""
        advanced = False
        while t > self._until:
            piece = next(self._pieces, None)
            if piece is None:
                break
            self._set_truth(join_pieces([self.truth.samples_since(t - WINDOW_LENGTH), piece]))
            advanced = True
        return advanced

    def _set_truth(self, truth: Truth) -> None:
        self.truth = truth
        self._until = float(truth.t[max(-_AHEAD, -len(truth))])
