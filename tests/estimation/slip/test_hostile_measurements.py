# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Extreme stamps of a faulty publisher: rejected by reason; nothing ends, stalls or grows."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import Measurement, Outcome, PoseFix, Sprockets, YawRate
from trackslip_estimation.slip.parameters import load_slip_parameters

S = 1_000_000_000
HOUR_NS = 3600 * S
START_NS = 1_700_000_000 * S


def with_rogue(
    measurements: list[Measurement], kind: type, apart_ns: int
) -> Iterator[tuple[Measurement, bool]]:
    """Present-day measurements, False; after each of ``kind`` a copy ``apart_ns`` later, True."""
    for m in measurements:
        own = replace(m, stamp_ns=START_NS + m.stamp_ns)
        yield own, False
        if isinstance(m, kind):
            yield replace(own, stamp_ns=own.stamp_ns + apart_ns), True


@pytest.mark.parametrize("kind", [PoseFix, YawRate, Sprockets])
@pytest.mark.parametrize(("hours", "outcome"), [(1, Outcome.AHEAD), (-1, Outcome.TOO_LATE)])
def test_stamps_an_hour_off_are_refused_and_change_nothing(
    drive: Callable[..., Any], kind: type, hours: int, outcome: Outcome
) -> None:
    driven = drive([(4.0, 2.0, 2.0, 0.1, 0.1, 0.0)])
    ends = []
    for apart_ns in (0, hours * HOUR_NS):
        estimator, last = SlipEstimator(load_slip_parameters()), None
        for m, is_rogue in with_rogue(driven.measurements, kind, apart_ns):
            if is_rogue and not apart_ns:
                continue
            report, estimate = estimator.process(m)
            if is_rogue and estimator.started:
                assert report.outcome is outcome
            last = estimate or last
        assert last is not None
        ends.append(last.pose)
    np.testing.assert_array_equal(*ends)


def test_a_source_may_be_bound_to_a_frame() -> None:
    p = load_slip_parameters({"sources.box_pose.frame_id": "map"})
    assert p.frames_of_sources() == {"box_pose": "map"}
    assert load_slip_parameters().frames_of_sources() == {}
