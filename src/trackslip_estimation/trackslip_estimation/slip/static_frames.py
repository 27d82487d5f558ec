# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Fixed frames of /tf_static: rotation of a sensor frame.

q_pc   rotation of vectors from the child frame into the parent frame, x, y, z, w
"""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from trackslip_common.arrays import FloatArray

_LONGEST = 100  # links from one frame to another


class StaticFrames:
    """A forest of frames; a later transform of a child replaces an earlier one."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, FloatArray]] = {}

    def add(self, parent: str, child: str, turn: Sequence[float]) -> None:
        """Add a link with q_pc (4,) of any length; one without a length is left out."""
        q = np.array(turn, np.float64)
        norm = float(np.linalg.norm(q))
        if math.isfinite(norm) and norm > 0.0:
            self._parents[_without_slash(child)] = (_without_slash(parent), q / norm)

    def angles(self, base: str, frame: str) -> tuple[float, float, float] | None:
        """Roll, pitch and yaw (ZYX) of ``frame`` in ``base``, rad; None: not connected."""
        from_base, from_frame = dict(self._ancestors(base)), dict(self._ancestors(frame))
        common = next((name for name in from_frame if name in from_base), None)
        if common is None:
            return None
        q = _product(_conjugate(from_base[common]), from_frame[common])
        x, y, z, w = q.tolist()
        sine = 2.0 * (w * y - z * x)
        if abs(sine) > 1.0 - 1e-12:  # yaw and roll turn about one axis
            return 0.0, math.copysign(math.pi / 2.0, sine), math.copysign(2.0, -sine) * math.atan2(x, w)
        roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
        return roll, math.asin(sine), math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))

    def _ancestors(self, frame: str) -> Iterator[tuple[str, FloatArray]]:
        """The frame and its ancestors, each with the rotation from the frame into it."""
        name, q = _without_slash(frame), np.array((0.0, 0.0, 0.0, 1.0))
        for _ in range(_LONGEST):
            yield name, q
            if name not in self._parents:
                return
            name, step = self._parents[name]
            q = _product(step, q)


def _without_slash(name: str) -> str:
    return name.removeprefix("/")


def _conjugate(q: FloatArray) -> FloatArray:
    return q * (-1.0, -1.0, -1.0, 1.0)


def _product(a: FloatArray, b: FloatArray) -> FloatArray:
    vector = a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])
    return np.append(vector, a[3] * b[3] - a[:3] @ b[:3])
