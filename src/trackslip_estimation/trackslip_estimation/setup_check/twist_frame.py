# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Speed of an odometry in the frame of the map instead of that of the machine.

    d      displacement by the fixes in a window                           (w, 2) m
    s      distance of the tracks in it, signed                            (w,) m

Of a machine, |s| is |d| but for slip. Along one axis of a map, s is d · a with a constant vector a.
"""

import numpy as np

from trackslip_estimation.setup_check.drive import Drive
from trackslip_estimation.setup_check.finding import LEAST_LOG, PRIOR, Cause, Finding, odds_of
from trackslip_estimation.setup_check.heading import window_displacements

_LEAST_WINDOWS = 20
_MOST_REST, _LEAST_REST = 0.1, 0.03  # shares of s² that d · a, and |d|, leave
_LEAST_GAIN = 3.0  # the rest of |d| over that of d · a: drives on one line, with pauses, leave both
_INDEPENDENT = 4  # windows of which the errors are one
_STDDEVS = 3.0  # of the fixes, by which a displacement exceeds their noise


def judge_twist_frame(drive: Drive) -> list[Finding]:
    """The cause if the tracks show one component of the displacement in the map, whatever the course."""
    if drive.fixes is None or drive.fixes.is_above:  # a swing moves the sensor, too
        return []
    moved = window_displacements(drive.fixes, drive.grid)
    tracks = drive.tracks_over_tread.mean(axis=1) * drive.machine.tread
    is_used = np.isfinite(moved) & np.isfinite(tracks) & (np.abs(moved) > _STDDEVS * drive.fixes.noise)
    if is_used.sum() < _LEAST_WINDOWS:
        return []
    moved, tracks = moved[is_used], tracks[is_used]
    total, noise = float(tracks @ tracks), len(tracks) * drive.fixes.noise**2
    if total <= _STDDEVS**2 * noise:  # turns on the spot alone
        return []
    d = np.column_stack((moved.real, moved.imag))
    axis = np.linalg.lstsq(d, tracks)[0]
    along_axis = max(float(np.sum((tracks - d @ axis) ** 2)), noise, 1e-9 * total)
    distance, driven = np.abs(moved), np.abs(tracks)
    along_course = float(np.sum((driven - distance * (driven @ distance) / (distance @ distance)) ** 2))
    ratio = along_course / along_axis
    gain = len(tracks) / (2.0 * _INDEPENDENT) * np.log(ratio) - PRIOR
    is_along_axis = ratio > _LEAST_GAIN and along_axis < _MOST_REST * total
    if gain < LEAST_LOG or not is_along_axis or along_course < _LEAST_REST * total:
        return []
    angle = float(np.degrees(np.arctan2(axis[1], axis[0])))
    evidence = (
        f"on all courses the speed is that along one direction of the map, {round(angle)}° from x; along the "
        f"course it errs {np.sqrt(ratio):.2g} times as much"
    )
    remedy = (
        "Record a twist in the frame of the machine (child_frame_id, REP 105), or the speeds of wheels or "
        "sprockets themselves"
    )
    return [Cause("twist_frame", "sprockets", evidence, odds_of(float(gain)), remedy)]
