# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Joint positions that restart after each turn, in bags and CSV logs."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fixtures.imports import import_csv, import_messages
from fixtures.made_bags import joints

NAMES = ["fl", "rl", "fr", "rr"]
STARTS = np.array((0.3, 2.0, 1.0, 5.9))
SPEEDS = np.array((5.0, 5.0, 4.0, 4.0))  # rad/s
T = np.arange(300) / 50.0
ANGLES = STARTS + T[:, np.newaxis] * SPEEDS
SIDES = {"left": NAMES[:2], "right": {"joints": NAMES[2:], "ratio": 0.5}}
VEHICLE = {"kinematics": {"rolling_radius": 0.15, "tread": 0.6, "contact_length": 0.5}}


def of_table(folder: Path, rows: list[str], topic: dict[str, Any]) -> list[Any]:
    """Messages that the importer makes of rows t, l, r."""
    text = "\n".join(("t,l,r", *rows, ""))
    return import_csv(folder, text, {"sprockets": topic}, vehicle=VEHICLE)[1]


def wrapped(first: float) -> np.ndarray[Any, Any]:
    angles: np.ndarray[Any, Any] = (ANGLES - first) % math.tau + first
    return angles


def of_bag(folder: Path, angles: Any, speeds: list[float]) -> list[Any]:
    """Messages that the importer makes of joint states."""
    states = (joints(t, NAMES, row, speeds) for t, row in zip(T.tolist(), angles.tolist(), strict=True))
    topics = {"sprockets": {"from": "/joint_states", **SIDES}}
    return import_messages(folder, (("/joint_states", one) for one in states), topics, vehicle=VEHICLE)[1]


@pytest.mark.parametrize(("first", "speeds"), [(-math.pi, []), (0.0, SPEEDS.tolist())])
def test_wrapping_positions_of_a_bag_are_continuous(
    first: float, speeds: list[float], tmp_path: Path
) -> None:
    """Each joint wraps at its own time and is unwrapped before the mean of the side and the ratio."""
    messages = of_bag(tmp_path, wrapped(first), speeds)
    np.testing.assert_allclose([m.velocity for m in messages], np.tile((5.0, 2.0), (len(T), 1)), atol=1e-9)
    positions = np.array([m.position for m in messages])
    np.testing.assert_allclose(positions - positions[0], np.outer(T, (5.0, 2.0)), atol=1e-9)


def test_continuous_positions_of_a_bag_stay_as_they_are(tmp_path: Path) -> None:
    messages = of_bag(tmp_path, ANGLES, [])
    means = np.column_stack(((ANGLES[:, 0] + ANGLES[:, 1]) / 2, (ANGLES[:, 2] + ANGLES[:, 3]) / 2 * 0.5))
    assert np.array([m.position for m in messages]).tobytes() == means.tobytes()


@pytest.mark.parametrize(("unit", "turn"), [("deg", 360.0), ("rev", 1.0)])
def test_wrapping_positions_of_a_csv_log_are_continuous(unit: str, turn: float, tmp_path: Path) -> None:
    """One encoder has a gear behind it; one cell is blank."""
    cells = (wrapped(-math.pi)[:, (0, 2)] / math.tau * turn).tolist()
    rows = [f"{t},{left:.12g},{right:.12g}" for t, (left, right) in zip(T.tolist(), cells, strict=True)]
    rows[100] = f"{T[100]},,"
    topic = {
        "left_position": {"column": "l", "unit": unit, "origin": "first"},
        "right_position": {"column": "r", "unit": unit, "scale": -0.25},
    }
    messages = of_table(tmp_path, rows, topic)
    assert len(messages) == len(T) - 1
    np.testing.assert_allclose(
        [m.velocity for m in messages], np.tile((5.0, -1.0), (len(messages), 1)), atol=1e-6
    )
    assert messages[0].position[0] == 0.0


@pytest.mark.parametrize(("bits", "is_signed"), [(8, False), (16, True), (24, False), (32, True)])
def test_counters_that_are_full_restart(bits: int, is_signed: bool, tmp_path: Path) -> None:
    """1000 counts a turn do not divide the counter's range; the left one counts up, the right one down."""
    modulus, least = 2**bits, -(2 ** (bits - 1)) if is_signed else 0
    speeds = np.array((600.0, -400.0))  # counts/s
    counts = np.round(np.outer(T, speeds)) + np.array((modulus - 100, 100))
    cells = (((counts - least) % modulus) + least).astype(np.int64).tolist()
    rows = [f"{t},{left},{right}" for t, (left, right) in zip(T.tolist(), cells, strict=True)]
    topic = {
        f"{side}_position": {"column": side[0], "unit": "rev", "scale": 1e-3} for side in ("left", "right")
    }
    messages = of_table(tmp_path, rows, topic)
    positions = np.array([m.position for m in messages])
    turned = np.round(np.outer(T, speeds)) * math.tau / 1000.0
    np.testing.assert_allclose(positions - positions[0], turned, atol=1e-6)


def test_positions_over_ground_have_no_turns(tmp_path: Path) -> None:
    """A jump of six metres is no wrap."""
    topic = {f"{side}_position": {"column": side[0], "unit": "m"} for side in ("left", "right")}
    messages = of_table(tmp_path, ["0,0,0", "0.5,6,0", "1,0.2,0"], topic)
    assert [m.position[0] * 0.15 for m in messages] == pytest.approx([0.0, 6.0, 0.2])
