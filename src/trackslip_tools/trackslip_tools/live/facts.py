# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Texts of the page: pose, motion, attitude, swing, and the reason why the soil is not identified."""

import math

import numpy as np

from trackslip_common.errors import printable
from trackslip_common.orientations import heading_text, tilt_of
from trackslip_common.topics import ATTITUDE, ODOMETRY, TRACK_SLIP
from trackslip_tools.live import inputs
from trackslip_tools.live.snapshot import Snapshot
from trackslip_tools.report.panel import SIGMAS

_MOTION_TEXTS = {1: "standing", 2: "straight", 3: "turning"}  # by motion_state
_UNKNOWN = "–"
FACT_NAMES = ("position", "heading", "motion", "speed", "roll", "pitch", "swing", "soil_reason")


def facts_of(now: Snapshot, now_s: float) -> dict[str, str]:
    """Name of ``FACT_NAMES`` → text; a dash if unknown."""
    facts = dict.fromkeys(FACT_NAMES, _UNKNOWN)
    facts["soil_reason"] = printable(now.reason)
    odometry, slip = now.get(ODOMETRY, now_s), now.get(TRACK_SLIP, now_s)
    if odometry is not None:
        x, y, heading = inputs.pose_of(odometry)
        radius = SIGMAS * math.sqrt(max(float(np.max(_eigenvalues(odometry.covariance[:2, :2]))), 0.0))
        facts["position"] = f"{x:.2f}, {y:.2f} m ± {radius:.{2 if radius >= 0.1 else 3}f}"
        facts["heading"] = heading_text(heading, float(odometry.covariance[2, 2]), SIGMAS)
        facts["speed"] = f"{odometry.v_x:.2f} m/s"
    if slip is not None:
        facts["motion"] = _MOTION_TEXTS.get(slip.motion_state, "no motion known")
    attitude = now.get(ATTITUDE, now_s)
    if attitude is not None and attitude.covariance[0] >= 0.0:
        sigmas = SIGMAS * np.sqrt(attitude.covariance)
        for name, angle, sigma in zip(("roll", "pitch"), tilt_of(attitude), sigmas, strict=True):
            facts[name] = f"{math.degrees(angle):.1f}° ± {math.degrees(float(sigma)):.1f}"
    swing = now.get(inputs.SWING, now_s)
    if swing is not None and math.isfinite(swing.angle):
        facts["swing"] = f"{math.degrees(math.remainder(swing.angle, 2.0 * math.pi)):.1f}°"
    return facts


def _eigenvalues(covariance: np.ndarray) -> np.ndarray:
    with np.errstate(all="ignore"):
        eigenvalues = np.linalg.eigvalsh(covariance) if np.isfinite(covariance).all() else np.zeros(1)
    return np.asarray(eigenvalues)
