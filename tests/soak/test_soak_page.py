# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A soak reports leaks, and does not report noise as a leak."""

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import soak
from soak_page import Sample, growth, growths, page


def series(leak_per_hour: float, seed: int, seconds: float = 3600.0) -> tuple[np.ndarray, np.ndarray]:
    """RSS in MB, every 10 s: a leak, noise correlated over a minute, and allocations of the first minutes."""
    draw = np.random.default_rng(seed)
    times = np.arange(0.0, seconds, 10.0)
    noise = np.zeros(times.size)
    for k in range(1, times.size):
        noise[k] = 0.85 * noise[k - 1] + draw.normal(0.0, 0.05)
    start = 20.0 * np.exp(-times / 60.0)
    return times, 200.0 - start + leak_per_hour * times / 3600.0 + noise


@pytest.mark.parametrize("leak", [2.0, 30.0])
def test_a_leak_is_found_and_its_rate_within_the_interval(leak: float) -> None:
    inside = 0
    for seed in range(40):
        result = growth(*series(leak, seed))
        assert result.is_certain
        inside += abs(result.per_hour - leak) < result.uncertainty
    assert inside >= 34  # 38 expected


def test_noise_is_not_reported_as_a_leak() -> None:
    certain = sum(growth(*series(0.0, seed)).is_certain for seed in range(100))
    assert certain <= 10  # 2.5 expected, more by the correlated noise


def test_missing_samples_do_not_hide_the_growth() -> None:
    times, values = series(30.0, 1)
    gaps = values.copy()
    gaps[::7] = np.nan
    result, whole = growth(times, gaps), growth(times, values)
    assert abs(result.per_hour - whole.per_hour) < 2.0 * whole.uncertainty
    assert math.isnan(growth(times, np.full_like(values, np.nan)).first)


def test_short_run_has_no_rate_and_constant_series_has_zero_growth() -> None:
    short = growth(*series(1.0, 1, seconds=250.0))
    assert (math.isnan(short.per_hour), short.is_certain) == (True, False)
    result = growth(np.arange(0.0, 600.0, 5.0), np.full(120, 18.0))
    assert (result.first, result.last, result.per_hour, result.uncertainty) == (18.0, 18.0, 0.0, 0.0)


def test_page_lists_only_series_present_in_every_sample() -> None:
    samples = [
        Sample(k * 10.0, {("slip_estimator", "RSS (MB)"): 200.0 + k, ("a", "b"): 1.0}) for k in range(40)
    ]
    samples[3] = Sample(30.0, {("slip_estimator", "RSS (MB)"): 203.0})
    assert list(growths(samples)) == [("slip_estimator", "RSS (MB)")]
    text = page(samples, {"messages lost": 0}, "forty samples")
    assert "| slip_estimator | RSS (MB) | 213 | 238 | 360 ± " in text
    assert "- messages lost: 0" in text


def test_each_note_of_the_page_is_an_item_of_a_list(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(soak, "OUT", tmp_path)
    samples = [
        Sample(k * 10.0, {("record", "threads"): 9.0 + k, ("player", "open files"): 5.0 + k})
        for k in range(40)
    ]
    monitor: Any = SimpleNamespace(totals={"estimates": 1, "reports missing": 0}, errors={"record: full": 2})
    soak._conclude(samples, monitor, "forty samples", {"player": 1})
    notes = (tmp_path / "soak.md").read_text().rpartition("|\n")[2].strip().splitlines()
    assert [note[:2] for note in notes] == ["- "] * 4
