# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The order of a window, and the sprocket speeds of the interval around a time."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import Sprockets
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.slip.records import MEASUREMENT, YAW_RATE, to_records
from trackslip_estimation.slip.sprockets import set_speeds, store_sample
from trackslip_estimation.slip.window import Records, insert, insertion_index, is_duplicate, make_window

MS = 1_000_000
COUNT = load_slip_parameters().encoder_resolution  # rad


@settings(max_examples=60)
@given(st.lists(st.tuples(st.integers(0, 60), st.integers(0, 2)), max_size=40))
def test_window_sorts_measurements_by_stamp(given_: list[tuple[int, int]]) -> None:
    """By stamp, then by source; entries that exist are found."""
    window = make_window(64, 1)
    expected: list[tuple[int, int]] = []
    for stamp, source in given_:
        arrival = window.measurements[-1:]
        arrival["stamp_ns"], arrival["source"], arrival["kind"] = stamp, source, YAW_RATE
        k = insertion_index(window.measurements, window.count, arrival[0])
        is_known = is_duplicate(window.measurements, window.count, k, arrival[0])
        assert is_known == ((stamp, source) in expected)
        if not is_known:
            insert(window, k)
            expected = sorted([*expected, (stamp, source)])
            assert expected[k] == (stamp, source)
        entries = window.measurements[: window.count]
        assert list(zip(entries["stamp_ns"].tolist(), entries["source"].tolist(), strict=True)) == expected


class Track:
    """Sprocket samples stored in a state, and the speeds at any time after the last one."""

    def __init__(self) -> None:
        estimator = SlipEstimator(load_slip_parameters({"sprocket_timeout": 1.0, "max_sprocket_speed": 1e9}))
        self._config = estimator.config
        self._state = estimator.window.best[:1].copy()

    def add(self, ms: int, speeds: tuple[float, float], angles: tuple[float, float] | None = None) -> None:
        store_sample(self._state[0], self.sample(ms, speeds, angles)[0], self._config[0])

    def sample(
        self, ms: int, speeds: tuple[float, float], angles: tuple[float, float] | None = None
    ) -> Records:
        return to_records((Sprockets("sprockets", ms * MS, *speeds, angles),), {})

    def speeds(self, ms: int, closing: Records | None = None) -> tuple[float, float] | None:
        nothing = np.zeros(1, MEASUREMENT)
        nothing["kind"] = YAW_RATE
        state = self._state.copy()
        known_ns = set_speeds(
            state[0], (nothing if closing is None else closing)[0], ms * MS, self._config[0]
        )
        found = state["speeds"][0]
        return (float(found["left"]), float(found["right"])) if known_ns == ms * MS else None


def test_speeds_are_those_of_the_interval_around_the_time() -> None:
    track = Track()
    assert track.speeds(5) is None
    first, second, third = (
        track.sample(ms, (9.0, 9.0), angles)
        for ms, angles in ((0, (1.0, 0.0)), (100, (2.0, 0.4)), (200, (3.0, 0.2)))
    )
    assert track.speeds(0, first) == (9.0, 9.0)  # no sample before it for a difference
    track.add(0, (9.0, 9.0), (1.0, 0.0))
    for ms in (1, 50, 100):
        assert track.speeds(ms, second) == pytest.approx((10.0, 4.0))
    track.add(100, (9.0, 9.0), (2.0, 0.4))
    counted = pytest.approx((10.0, -2.0), abs=COUNT / 0.1)
    for ms in (101, 200):
        assert track.speeds(ms, third) == counted
    track.add(200, (9.0, 9.0), (3.0, 0.2))
    assert track.speeds(300) == counted  # after the last sample as before it


def test_without_positions_the_closing_sample_shows_the_speed() -> None:
    track = Track()
    assert track.speeds(0, track.sample(0, (1.0, -1.0))) == (1.0, -1.0)
    track.add(0, (1.0, -1.0))
    closing = track.sample(100, (2.0, -2.0))
    assert [track.speeds(ms, closing) for ms in (50, 100)] == [(2.0, -2.0)] * 2
    track.add(100, (2.0, -2.0))
    assert track.speeds(200) == (2.0, -2.0)
