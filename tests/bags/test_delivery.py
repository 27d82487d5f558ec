# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Log times of messages that were sent again."""

from trackslip_bags.recording import DeliveryOrder

S = 1_000_000_000


def test_what_waited_for_a_repair_is_not_logged_before_it() -> None:
    """Two and three were received first, delivered after one, which was lost and sent again."""
    order = DeliveryOrder()
    came = {0: 10 * S, 1: 13 * S, 2: 11 * S, 3: 12 * S, 4: 14 * S}
    logged = [order.after_all_before("odometry", came_ns) for came_ns in came.values()]
    assert logged == [10 * S, 13 * S, 13 * S, 13 * S, 14 * S]
    assert order.after_all_before("sprockets", 11 * S) == 11 * S


def test_a_clock_that_was_set_back_is_followed() -> None:
    order = DeliveryOrder()
    came = (100 * S, 40 * S, 41 * S, 140 * S)
    assert tuple(order.after_all_before("odometry", came_ns) for came_ns in came) == came
