# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The reported reason of rejections: steady under noise, and soon the new one after a change."""

import itertools

import numpy as np

from trackslip_drivers.frequent_reason import STAMP_EVENTS, FrequentReason, Key

GARBLED, OVERLONG, CHECKSUM = (("line", text) for text in ("garbled", "overlong", "checksum"))


def test_noise_with_several_reasons_is_one_state() -> None:
    reason, reported = FrequentReason(), list[Key]()
    for k, counts in enumerate(np.random.default_rng(3).poisson(1.5, (60, 2)).tolist()):
        if any(counts):
            reported.append(reason.update(dict(zip((GARBLED, OVERLONG), counts, strict=True)), float(k)))
    assert sum(a != b for a, b in itertools.pairwise(reported)) <= 3


def test_new_reason_is_reported_within_seconds() -> None:
    reason = FrequentReason()
    for k in range(60):
        assert reason.update({GARBLED: 10}, float(k)) == GARBLED
    assert [reason.update({CHECKSUM: 10}, 60.0 + k) for k in range(10)][5:] == [CHECKSUM] * 5


def test_rejection_replaces_an_event_at_once() -> None:
    reason, event = FrequentReason(), ("stamps", min(STAMP_EVENTS))
    assert reason.update({event: 2}, 0.0) == event
    assert reason.update({CHECKSUM: 2}, 0.1) == CHECKSUM
