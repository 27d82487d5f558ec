# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Any text after an option of ``trackslip replay`` is used, or rejected by ``InputError``."""

import contextlib
from collections.abc import Callable

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from trackslip_bags.input_filters import parse_remap, parse_thin, parse_withhold
from trackslip_common.errors import InputError
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_tools.cli.replay_options import parse_set

PARSERS: dict[str, Callable[[str], object]] = {
    "withhold": parse_withhold,
    "thin": parse_thin,
    "remap": parse_remap,
    "set": lambda text: load_slip_parameters(dict([parse_set(text)])),
}
PIECES = ("box_pose", "10", "1.0", "/a", ":=", "slip_estimator", "history_window", *":.=[]-")
texts = st.one_of(st.text(), st.lists(st.one_of(st.sampled_from(PIECES), st.text(max_size=3))).map("".join))


@pytest.mark.parametrize("option", PARSERS)
@given(text=texts)
@example(text="box_pose:10:40")
@example(text="box_pose:1.0:0.05")
@example(text="slip_estimator.history_window=[3.0]")
@example(text="\udcff\udcfe")
def test_option_is_used_or_refused(option: str, text: str) -> None:
    with contextlib.suppress(InputError):
        PARSERS[option](text)
