# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The order of a window."""

from hypothesis import given, settings
from hypothesis import strategies as st

from trackslip_estimation.slip.records import YAW_RATE
from trackslip_estimation.slip.window import insert, insertion_index, is_duplicate, make_window


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
