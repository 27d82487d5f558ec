# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Counts by reason, also while another thread reads them."""

import sys
import threading
from enum import Enum

from trackslip_common.tally import Tally


class Reason(Enum):
    TEXT = "a text"
    NUMBER = 3


def test_reasons_are_counted_by_source() -> None:
    tally = Tally()
    tally.add("b", Reason.TEXT)
    tally.add("a", Reason.NUMBER, 2)
    assert tally.by_source() == {"a": {"number": 2}, "b": {"a text": 1}}
    assert tally.new_counts() == {("a", "number"): 2, ("b", "a text"): 1}
    tally.add("a", Reason.NUMBER)
    assert tally.new_counts() == {("a", "number"): 1}
    assert tally.total["a", "number"] == 3


def test_each_reason_shows_its_latest_detail() -> None:
    tally = Tally()
    for detail in ("7 fields", "8 fields", ""):
        tally.add("a", Reason.TEXT, detail=detail)
    tally.add("a", Reason.NUMBER)
    assert [tally.detail_or_reason(key) for key in tally.total] == ["8 fields", "number"]


def test_tally_is_read_while_another_thread_counts() -> None:
    """New keys may be added while a copy or a sorted list is made."""
    tally, failures, begun = Tally(), [], threading.Event()
    kinds = Enum("kinds", {f"k{k}": f"k{k}" for k in range(5_000)})  # type: ignore[misc]

    def count() -> None:
        begun.set()
        for kind in kinds:
            tally.add("source", kind)

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    thread = threading.Thread(target=count)
    try:
        thread.start()
        begun.wait()
        seen = 0
        while thread.is_alive():
            try:
                seen += sum(tally.new_counts().values())
                tally.by_source()
            except RuntimeError as error:
                failures.append(error)
                break
    finally:
        thread.join()
        sys.setswitchinterval(interval)
    assert failures == []
    assert seen + sum(tally.new_counts().values()) == 5_000


def test_reason_with_a_count_of_zero_is_not_shown() -> None:
    tally = Tally()
    tally.add("imu", Reason.TEXT, 0)
    assert tally.by_source() == {}
