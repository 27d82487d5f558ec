# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Entry point of the live page's node; its module is loaded only when called (see ``start``)."""

from trackslip_common.start import start


def live() -> None:
    """See ``trackslip_tools.nodes.live``."""
    start("trackslip_tools.nodes.live")
