# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""File of the box's track, for a localizer that is restarted during a drive.

Without it the search would begin at the initial pose, where the box no longer is. It also keeps the
background, without which a stationary object could be taken for the box. It is JSON, written to a temporary
file and moved into place; a file that is no track is moved aside. The file need not survive a power failure,
so writing does not wait for the disk.
"""

import json
import math
from typing import Any

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.atomic_files import atomic_replacement
from trackslip_common.errors import InputError
from trackslip_common.kept_files import move_aside, parameter_path
from trackslip_estimation.box.background import Background
from trackslip_estimation.box.heading_ambiguity import Headings, SideEvidence
from trackslip_estimation.box.scan import FULL_TURN, MOST_BEAMS
from trackslip_estimation.box.track import LocalizerState, Track
from trackslip_estimation.covariance import is_covariance

_VERSION = 3
_MILLIMETRES = 1000.0  # in a metre
_LONGEST_RANGE = 10_000_000  # mm; longer ranges count as no return
_NO_RETURN = -1
_LARGEST_FILE = 4096 + 20 * MOST_BEAMS  # bytes
_PERIOD_NS = 1_000_000_000  # scan time between two writings


def track_text(state: LocalizerState) -> str:
    """Return the content of the file."""
    track = state.track
    evidence = track.headings.evidence
    return json.dumps(
        {
            "version": _VERSION,
            "scan_ns": state.scan_ns,
            "stamp_ns": track.stamp_ns,
            "mean": track.mean.tolist(),
            "covariance": track.covariance.tolist(),
            "weights": track.headings.weights.tolist(),
            "evidence": [evidence.settled, evidence.mean, evidence.count, evidence.x, evidence.y],
            "laser": state.laser,
            "beams": [state.background.angle_min, state.background.spacing],
            "background": _to_millimetres(state.background.ranges),
            "free": _to_millimetres(state.background.free),
        }
    )


def parse_track(text: str) -> LocalizerState:
    """Return the state from a text of ``track_text``.

    Raises:
        InputError: the text is invalid.
    """
    try:
        tree: Any = json.loads(text)
        if tree["version"] != _VERSION:
            raise InputError(f"it is of version {str(tree['version'])[:9]!r}, not {_VERSION}")
        scan_ns, stamp_ns = int(tree["scan_ns"]), int(tree["stamp_ns"])
        mean = np.array(tree["mean"], dtype=np.float64).reshape(3, 2)
        covariance = np.array(tree["covariance"], dtype=np.float64).reshape(3, 2, 2)
        weights = np.array(tree["weights"], dtype=np.float64).reshape(4)
        settled, average, count, x, y = (float(value) for value in tree["evidence"])
        evidence = SideEvidence(settled, average, int(count), x, y)
        laser_x, laser_y, laser_yaw = (float(value) for value in tree["laser"])
        angle_min, spacing = (float(value) for value in tree["beams"])
        ranges, free = (_from_millimetres(tree[name]) for name in ("background", "free"))
        background = Background(angle_min, spacing, ranges, free)
    except InputError:  # a ValueError, too
        raise
    except (ValueError, TypeError, LookupError, OverflowError, RecursionError) as error:
        raise InputError("it is not the track of a box") from error
    geometry = np.array([laser_x, laser_y, laser_yaw, angle_min, spacing])
    numbers = (mean, covariance, weights, np.array([settled, average, count, x, y]), geometry)
    are_stamps_valid = all(0 <= ns < 2**63 for ns in (stamp_ns, scan_ns))
    if not are_stamps_valid or not all(np.isfinite(array).all() for array in numbers):
        raise InputError("it has values out of range")
    if not all(map(is_covariance, covariance)):
        raise InputError("its covariance is invalid")
    if weights.min() < 0.0 or not math.isclose(weights.sum(), 1.0, rel_tol=1e-6) or count < 0:
        raise InputError("its probabilities are invalid")
    are_angles_valid = max(abs(angle_min), abs(spacing)) <= FULL_TURN
    if not are_angles_valid or len(ranges) != len(free) or len(ranges) > MOST_BEAMS:
        raise InputError("its background is invalid")
    track = Track(stamp_ns, mean, covariance, Headings(weights, evidence))
    return LocalizerState(track, scan_ns, background, (laser_x, laser_y, laser_yaw))


def _to_millimetres(ranges: FloatArray) -> list[int | None]:
    """Return the range of each beam, mm; None if unknown (NaN, −∞), ``_NO_RETURN`` without a return."""
    rounded = np.rint(np.clip(ranges * _MILLIMETRES, -np.inf, _LONGEST_RANGE + 1.0))
    return [
        None if not mm >= 0.0 else int(mm) if mm <= _LONGEST_RANGE else _NO_RETURN for mm in rounded.tolist()
    ]


def _from_millimetres(numbers: list[int | None]) -> FloatArray:
    """Return the ranges (N,), m.

    Raises:
        ValueError: there is no list, or a number is out of range.
    """
    if not isinstance(numbers, list):
        raise ValueError("no list")
    ranges = np.array([math.nan if mm is None else float(mm) for mm in numbers], dtype=np.float64)
    is_far = ranges == _NO_RETURN
    if not np.all(np.isnan(ranges) | is_far | (ranges >= 0.0) & (ranges <= _LONGEST_RANGE)):
        raise ValueError("a range is out of range")
    return np.where(is_far, math.inf, ranges / _MILLIMETRES)


class TrackFile:
    """Track file of one node; with an empty path nothing is read or written."""

    def __init__(self, path: str) -> None:
        """``path`` may begin with ~.

        Raises:
            InputError: the home directory is unknown.
        """
        self._path = parameter_path("track_file", path)
        self._written_ns = 0
        self._is_foreign = False  # whether the present file is no track
        self.failures = 0
        self.failure = ""  # why the last reading or writing failed; empty if it did not

    def read(self) -> LocalizerState | None:
        """Return the state in the file; None if there is no usable one, see ``failure``."""
        if self._path is None:
            return None
        try:
            if not self._path.is_file():
                return None
            with self._path.open("rb") as file:
                content = file.read(_LARGEST_FILE + 1)
            return parse_track(content.decode("utf-8", errors="replace"))
        except (InputError, OSError) as error:
            self._is_foreign = True
            self._record_failure(f"{self._path} is not used: {getattr(error, 'strerror', None) or error}")
            return None

    def write(self, state: LocalizerState | None) -> None:
        """Write the state, at most once a second of scan time."""
        if self._path is None or state is None or abs(state.scan_ns - self._written_ns) < _PERIOD_NS:
            return
        self._written_ns = state.scan_ns
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with atomic_replacement(self._path, track_text(state)):
                if self._is_foreign:
                    move_aside(self._path)
                self._is_foreign = False
        except (OSError, ValueError) as error:  # ValueError: no path at all
            self._record_failure(f"{self._path} is not written: {getattr(error, 'strerror', None) or error}")
            return
        self.failure = ""

    def _record_failure(self, reason: str) -> None:
        self.failures += 1
        self.failure = reason
