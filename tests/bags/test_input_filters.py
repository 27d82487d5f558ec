# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Filters that a replay applies to the input of the estimator: parsed and rejected."""

import math
from collections.abc import Callable

import pytest

from trackslip_bags.input_filters import (
    InputFilters,
    Thin,
    Withhold,
    parse_remap,
    parse_thin,
    parse_withhold,
)
from trackslip_common.errors import InputError


@pytest.mark.parametrize(
    ("parse", "text", "expected"),
    [
        (parse_withhold, "box_pose", Withhold("box_pose", -math.inf, math.inf)),
        (parse_withhold, "/box_pose", Withhold("box_pose", -math.inf, math.inf)),
        (parse_withhold, "imu/data_raw:1:2.5", Withhold("imu/data_raw", 1.0, 2.5)),
        (parse_thin, "box_pose:1", Thin("box_pose", 1.0, None)),
        (parse_thin, "/box_pose:0.5:0.05", Thin("box_pose", 0.5, 0.05)),
        (parse_remap, "/gnss/pose:=box_pose", ("gnss/pose", "box_pose")),
    ],
)
def test_options_are_parsed_with_relative_names(
    parse: Callable[[str], object], text: str, expected: object
) -> None:
    assert parse(text) == expected


@pytest.mark.parametrize(
    "text", ["", ":1:2", "a:1", "a:1:2:3", "a:b:c", "a:2:1", "a:1:1", "a:1:nan", "a:1:inf", "a::", "a:"]
)
def test_withhold_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"^--withhold .*: accepted: TOPIC or TOPIC:T0:T1.*\Z"):
        parse_withhold(text)


@pytest.mark.parametrize(
    "text",
    [
        *("", "a", "a:", ":1", "a:0", "a:-1", "a:x", "a:nan", "a:inf", "a:1:", "a:1:x", "a:1:-0.1", "a:1:0"),
        *("a:1:nan", "a:1:inf", "a:1:2:3", "a:1e10", "a:1e-300", "a:1:1e200"),
    ],
)
def test_thin_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"^--thin .*: accepted: TOPIC:HZ.*\Z"):
        parse_thin(text)


@pytest.mark.parametrize("text", ["", "a", "a:b", "a=b", ":=b", "a:="])
def test_remap_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"^--remap .*: accepted: from:=to$"):
        parse_remap(text)


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
def test_filters_that_change_the_inputs_are_known(filters: InputFilters, changes: bool) -> None:
    assert filters.changes_inputs is changes
