# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Whether the stamps of a topic go on as they did, compiled.

Many in a row that are out of line, but in line with each other, are another time.
"""

from typing import Any

import numpy as np

from trackslip_common.compiled import compiled

_NS_PER_S = 1e9
NEVER = np.iinfo(np.int64).min
IN_LINE, FAR_AHEAD, BEHIND, BACK = range(4)  # where a stamp lies

_STREAK = np.dtype([("count", "i8"), ("last_ns", "i8")])  # stamps in a row that are out of line alike
CLOCK = np.dtype([("head_ns", "i8"), ("ahead", _STREAK), ("behind", _STREAK)])


@compiled
def ns_of(seconds: float) -> int:
    """As stamps count."""
    return round(seconds * _NS_PER_S)


@compiled
def follow(clock: Any, stamp_ns: int, oldest_ns: int, p: Any) -> int:
    """Where a stamp lies on a CLOCK, which goes on; ``p``: record of SynchronizerParameters.

    ``oldest_ns``: older ones have no place; NEVER where there is none.
    """
    gap_ns = ns_of(p.max_gap)
    floor_ns = oldest_ns
    if clock.head_ns != NEVER:
        floor_ns = max(floor_ns, clock.head_ns - gap_ns)
    if stamp_ns < floor_ns:
        clock.ahead.count = 0
        return BACK if _extend(clock.behind, stamp_ns, gap_ns) >= p.jump_confirmations else BEHIND
    clock.behind.count = 0
    is_far = clock.head_ns != NEVER and stamp_ns > clock.head_ns + gap_ns
    if is_far and _extend(clock.ahead, stamp_ns, gap_ns) < p.jump_confirmations:
        return FAR_AHEAD
    clock.ahead.count = 0
    clock.head_ns = max(clock.head_ns, stamp_ns)
    return IN_LINE


@compiled
def _extend(streak: Any, stamp_ns: int, gap_ns: int) -> int:
    """How many there are by now; a stamp that does not follow on the last one begins anew."""
    follows = streak.count > 0 and 0 < stamp_ns - streak.last_ns <= gap_ns
    streak.count = streak.count + 1 if follows else 1
    streak.last_ns = stamp_ns
    return int(streak.count)


@compiled
def start_again(clock: Any, stamp_ns: int) -> None:
    """At another time."""
    clock.head_ns = stamp_ns
    clock.ahead.count = clock.behind.count = 0
