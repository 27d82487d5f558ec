# SPDX-License-Identifier: Apache-2.0
"""What a replay changes before the estimator sees it: parsed, refused, and done."""

import math

import numpy as np
import pytest

from trackslip_bags.input_filters import (
    Arrival,
    InputFilters,
    Thin,
    Withhold,
    apply,
    parse_remap,
    parse_thin,
    parse_withhold,
)
from trackslip_common.errors import InputError
from trackslip_estimation.slip.measurements import PoseFix, Sprockets, YawRate

MS = 1_000_000
ORIGIN_NS = 10**15


def fixes(count: int, period_ms: float, source: str = "box_pose", latency_ms: int = 300) -> list[Arrival]:
    """Fixes at the origin, stamped some time before they are logged."""
    covariance = np.array(((4.0, 1.0, 0.5), (1.0, 4.0, 0.5), (0.5, 0.5, 1.0)))
    arrivals = []
    for k in range(count):
        log_ns = ORIGIN_NS + round(k * period_ms * MS)
        arrivals.append(Arrival(log_ns, PoseFix(source, log_ns - latency_ms * MS, np.zeros(3), covariance)))
    return arrivals


def logged(arrivals: list[Arrival]) -> list[float]:
    """Log times, s from the bag's first message."""
    return [(a.log_time_ns - ORIGIN_NS) * 1e-9 for a in arrivals]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("box_pose", Withhold("box_pose", -math.inf, math.inf)),
        ("/box_pose", Withhold("box_pose", -math.inf, math.inf)),
        ("imu/data_raw:1:2.5", Withhold("imu/data_raw", 1.0, 2.5)),
    ],
)
def test_withhold_is_parsed(text: str, expected: Withhold) -> None:
    assert parse_withhold(text) == expected


@pytest.mark.parametrize(
    "text", ["", ":1:2", "a:1", "a:1:2:3", "a:b:c", "a:2:1", "a:1:1", "a:1:nan", "a:1:inf", "a::", "a:"]
)
def test_withhold_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"^--withhold .*: accepted: TOPIC or TOPIC:T0:T1") as caught:
        parse_withhold(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("box_pose:1", Thin("box_pose", 1.0, None)),
        ("/box_pose:0.5:0.05", Thin("box_pose", 0.5, 0.05)),
    ],
)
def test_thin_is_parsed(text: str, expected: Thin) -> None:
    assert parse_thin(text) == expected


@pytest.mark.parametrize(
    "text",
    [
        *("", "a", "a:", ":1", "a:0", "a:-1", "a:x", "a:nan", "a:inf", "a:1:", "a:1:x", "a:1:-0.1", "a:1:0"),
        *("a:1:nan", "a:1:inf", "a:1:2:3", "a:1e10", "a:1e-300", "a:1:1e200"),
    ],
)
def test_thin_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"^--thin .*: accepted: TOPIC:HZ") as caught:
        parse_thin(text)
    assert "\n" not in str(caught.value)


def test_remap_is_parsed() -> None:
    assert parse_remap("/gnss/pose:=box_pose") == ("gnss/pose", "box_pose")


@pytest.mark.parametrize("text", ["", "a", "a:b", "a=b", ":=b", "a:="])
def test_remap_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"^--remap .*: accepted: from:=to$"):
        parse_remap(text)


def test_withholding_goes_by_log_time_and_is_half_open() -> None:
    filters = InputFilters(withhold=(Withhold("box_pose", 1.0, 2.0),))
    kept = logged(apply(filters, fixes(31, 100), ORIGIN_NS))
    assert kept == pytest.approx([k / 10 for k in range(31) if not 10 <= k < 20])


def test_withholding_leaves_other_topics_alone() -> None:
    other = fixes(3, 100, source="gnss")
    assert apply(InputFilters(withhold=(Withhold("box_pose"),)), [*fixes(3, 100), *other], ORIGIN_NS) == other


def test_outages_add_up() -> None:
    filters = InputFilters(withhold=(Withhold("box_pose", 0.0, 0.5), Withhold("box_pose", 0.3, 0.9)))
    assert logged(apply(filters, fixes(11, 100), ORIGIN_NS)) == pytest.approx([0.9, 1.0])


@pytest.mark.parametrize(("rate", "period_ms"), [(1.0, 217.0), (2.0, 100.0), (4.0, 33.3), (3.0, 100.0)])
def test_thinning_keeps_the_rate(rate: float, period_ms: float) -> None:
    """Ticks that do not drift: the mean rate holds although the samples do not fall on the ticks."""
    kept = logged(apply(InputFilters(thin=(Thin("box_pose", rate),)), fixes(1000, period_ms), ORIGIN_NS))
    span = 999 * period_ms * 1e-3
    assert len(kept) == math.floor(span * rate + 1e-9) + 1
    ticks = np.arange(len(kept)) / rate
    assert (np.array(kept) - ticks >= -1e-9).all()
    assert (np.array(kept) - ticks < period_ms * 1e-3).all()


def test_thinning_slower_than_the_source_keeps_all() -> None:
    assert len(apply(InputFilters(thin=(Thin("box_pose", 10.0),)), fixes(50, 400), ORIGIN_NS)) == 50


def test_thinning_goes_on_after_a_gap() -> None:
    arrivals = [a for a in fixes(100, 100) if not 2.0 < (a.log_time_ns - ORIGIN_NS) * 1e-9 < 5.55]
    kept = logged(apply(InputFilters(thin=(Thin("box_pose", 1.0),)), arrivals, ORIGIN_NS))
    assert kept == pytest.approx([0.0, 1.0, 2.0, 5.6, 6.0, 7.0, 8.0, 9.0])


def test_thinning_leaves_other_topics_and_their_order_alone() -> None:
    both = sorted([*fixes(30, 100), *fixes(30, 130, source="gnss")], key=lambda a: a.log_time_ns)
    kept = apply(InputFilters(thin=(Thin("box_pose", 1.0, 0.1),)), both, ORIGIN_NS)
    assert [a for a in kept if a.measurement.source == "gnss"] == [
        a for a in both if a.measurement.source == "gnss"
    ]
    assert logged(kept) == sorted(logged(kept))


def test_thinning_without_sigma_changes_no_number() -> None:
    arrivals = fixes(10, 1000)
    assert apply(InputFilters(thin=(Thin("box_pose", 1.0),)), arrivals, ORIGIN_NS) == arrivals


def test_the_added_noise_is_of_sigma_and_the_covariance_says_so() -> None:
    kept = apply(InputFilters(thin=(Thin("box_pose", 10.0, 0.05),)), fixes(2000, 100), ORIGIN_NS)
    poses = np.array([a.measurement.pose for a in kept if isinstance(a.measurement, PoseFix)])
    assert len(poses) == 2000
    assert poses[:, :2].std(axis=0) == pytest.approx(0.05, rel=0.06)
    assert poses[:, :2].mean(axis=0) == pytest.approx(0.0, abs=0.005)
    assert abs(np.corrcoef(poses[:, 0], poses[:, 1])[0, 1]) < 0.08
    assert (poses[:, 2] == 0.0).all()
    for arrival in kept[:3]:
        assert isinstance(arrival.measurement, PoseFix)
        np.testing.assert_allclose(arrival.measurement.covariance, np.diag((0.0025, 0.0025, 1.0)))


def test_the_noise_is_seeded_and_the_source_stays_as_it_was() -> None:
    arrivals, thin = fixes(10, 100), (Thin("box_pose", 10.0, 0.05),)

    def noise(seed: int) -> list[float]:
        kept = apply(InputFilters(thin=thin, seed=seed), arrivals, ORIGIN_NS)
        return [float(a.measurement.pose[0]) for a in kept if isinstance(a.measurement, PoseFix)]

    assert noise(1) == noise(1)
    assert noise(1) != noise(2)
    assert all((a.measurement.pose == 0.0).all() for a in arrivals if isinstance(a.measurement, PoseFix))


@pytest.mark.parametrize(
    "measurement", [YawRate("imu", ORIGIN_NS, 1.0, 1.0), Sprockets("sprockets", ORIGIN_NS, 1.0, 1.0)]
)
def test_only_positions_take_noise(measurement: YawRate | Sprockets) -> None:
    arrivals = [Arrival(ORIGIN_NS, measurement)]
    assert apply(InputFilters(thin=(Thin(measurement.source, 1.0, 0.05),)), arrivals, ORIGIN_NS) == arrivals


@pytest.mark.parametrize(
    ("filters", "changes"),
    [
        (InputFilters(), False),
        (InputFilters(seed=3), False),
        (InputFilters(start_s=1.0), True),
        (InputFilters(stop_s=9.0), True),
        (InputFilters(remap={"a": "b"}), True),
        (InputFilters(withhold=(Withhold("a"),)), True),
        (InputFilters(thin=(Thin("a", 1.0),)), True),
    ],
)
def test_edits_know_whether_live_can_be_compared(filters: InputFilters, changes: bool) -> None:
    assert filters.changes_inputs is changes
