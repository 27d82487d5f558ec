# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Withholding and thinning of inputs before the estimator receives them."""

import numpy as np
import pytest
from fixtures.arrival_rows import rows_of
from hypothesis import given
from hypothesis import strategies as st

from trackslip_bags.input_filters import InputFilters, Thin, Withhold
from trackslip_common.arrays import Rows
from trackslip_estimation.slip.measurements import PoseFix, Sprockets, YawRate
from trackslip_tools.replay.filtering import ArrivalFilter, Withholding

MS = 1_000_000
ORIGIN_NS = 10**15
SOURCES = ("box_pose", "gnss", "imu", "sprockets")


def fixes(count: int, period_ms: float, source: str = "box_pose", latency_ms: int = 300) -> Rows:
    """Fixes at the origin, stamped ``latency_ms`` before their log times."""
    covariance = np.array(((4.0, 1.0, 0.5), (1.0, 4.0, 0.5), (0.5, 0.5, 1.0)))
    times_ns = [ORIGIN_NS + round(k * period_ms * MS) for k in range(count)]
    arrivals = [(t, PoseFix(source, t - latency_ms * MS, np.zeros(3), covariance)) for t in times_ns]
    return rows_of(arrivals, SOURCES)


def apply(filters: InputFilters, arrivals: Rows) -> Rows:
    return arrival_filter(filters)(arrivals)


def arrival_filter(filters: InputFilters) -> ArrivalFilter:
    return ArrivalFilter(filters, SOURCES, Withholding(filters, ORIGIN_NS))


def logged(arrivals: Rows) -> list[float]:
    """Log times, s from the bag's first message."""
    times: list[float] = ((arrivals["log_time_ns"] - ORIGIN_NS) * 1e-9).tolist()
    return times


def test_withholding_is_a_half_open_interval_of_log_time() -> None:
    filters = InputFilters(withhold=(Withhold("box_pose", 1.0, 2.0),))
    kept = logged(apply(filters, fixes(31, 100)))
    assert kept == pytest.approx([k / 10 for k in range(31) if not 10 <= k < 20])


def test_withholding_leaves_other_topics_alone() -> None:
    other = fixes(3, 100, source="gnss")
    kept = apply(InputFilters(withhold=(Withhold("box_pose"),)), np.concatenate((fixes(3, 100), other)))
    np.testing.assert_array_equal(kept, other)


def test_outages_add_up() -> None:
    filters = InputFilters(withhold=(Withhold("box_pose", 0.0, 0.5), Withhold("box_pose", 0.3, 0.9)))
    assert logged(apply(filters, fixes(11, 100))) == pytest.approx([0.9, 1.0])


@given(
    rate=st.floats(0.5, 20.0),
    steps_ms=st.lists(st.integers(1, 3000), min_size=1, max_size=60),
    cuts=st.lists(st.integers(0, 60), max_size=3),
)
def test_thinning_keeps_the_first_message_at_or_after_each_tick(
    rate: float, steps_ms: list[int], cuts: list[int]
) -> None:
    """Ticks do not drift, continue on their grid after a gap, and do not depend on the batches."""
    arrivals = fixes(len(steps_ms), 100)
    arrivals["stamp_ns"] = ORIGIN_NS + MS * np.cumsum(steps_ms)
    in_batches = arrival_filter(InputFilters(thin=(Thin("box_pose", rate),)))
    kept = np.concatenate([in_batches(batch) for batch in np.split(arrivals, sorted(cuts))])
    period_ns = round(1e9 / rate)
    ticks = (arrivals["stamp_ns"] - arrivals["stamp_ns"][0]) // period_ns
    expected = np.concatenate(([True], np.diff(ticks) > 0))
    np.testing.assert_array_equal(kept, arrivals[expected])


def test_thinning_leaves_other_topics_and_their_order_alone() -> None:
    both = np.concatenate((fixes(30, 100), fixes(30, 130, source="gnss")))
    both = both[np.argsort(both["log_time_ns"], kind="stable")]
    kept = apply(InputFilters(thin=(Thin("box_pose", 1.0, 0.1),)), both)
    gnss = SOURCES.index("gnss")
    np.testing.assert_array_equal(kept[kept["source"] == gnss], both[both["source"] == gnss])
    assert logged(kept) == sorted(logged(kept))


def test_the_added_noise_is_of_sigma_and_the_covariance_states_it() -> None:
    kept = apply(InputFilters(thin=(Thin("box_pose", 10.0, 0.05),)), fixes(2000, 100))
    poses = kept["value"]
    assert len(poses) == 2000
    assert poses[:, :2].std(axis=0) == pytest.approx(0.05, rel=0.06)
    assert poses[:, :2].mean(axis=0) == pytest.approx(0.0, abs=0.005)
    assert abs(np.corrcoef(poses[:, 0], poses[:, 1])[0, 1]) < 0.08
    assert (poses[:, 2] == 0.0).all()
    np.testing.assert_allclose(kept["noise"][:3], np.broadcast_to(np.diag((0.0025, 0.0025, 1.0)), (3, 3, 3)))


def test_noise_is_seeded_and_leaves_the_input_unchanged() -> None:
    arrivals, thin = fixes(10, 100), (Thin("box_pose", 10.0, 0.05),)

    def noise(seed: int) -> list[float]:
        values: list[float] = apply(InputFilters(thin=thin, seed=seed), arrivals)["value"][:, 0].tolist()
        return values

    assert noise(1) == noise(1)
    assert noise(1) != noise(2)
    assert (arrivals["value"] == 0.0).all()


@pytest.mark.parametrize(
    "measurement", [YawRate("imu", ORIGIN_NS, 1.0, 1.0), Sprockets("sprockets", ORIGIN_NS, 1.0, 1.0)]
)
def test_noise_is_added_only_to_positions(measurement: YawRate | Sprockets) -> None:
    arrivals = rows_of([(ORIGIN_NS, measurement)], SOURCES)
    kept = apply(InputFilters(thin=(Thin(measurement.source, 1.0, 0.05),)), arrivals)
    assert kept.tobytes() == arrivals.tobytes()
