# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Fuzz target on the options of ``trackslip replay``; ``InputError`` is fine."""

import contextlib
from collections.abc import Callable

from trackslip_bags.input_filters import parse_remap, parse_thin, parse_withhold
from trackslip_common.errors import InputError
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_tools.cli.replay_options import parse_set

Target = tuple[Callable[[bytes], None], list[bytes]]


def replay_options() -> Target:
    """The text behind --withhold, --thin, --remap and --set."""
    parsers: tuple[Callable[[str], object], ...] = (
        parse_withhold,
        parse_thin,
        parse_remap,
        lambda text: load_slip_parameters(dict([parse_set(text)])),
    )

    def one_input(data: bytes) -> None:
        with contextlib.suppress(InputError):
            parsers[data[0] % len(parsers) if data else 0](data[1:].decode("utf-8", "surrogateescape"))

    texts = ("\0box_pose:10:40", "\1box_pose:1.0:0.05", "\2/a:=b", "\3slip_estimator.history_window=[3.0]")
    return one_input, [text.encode() for text in texts]


TARGETS = {replay_options.__name__: replay_options}
