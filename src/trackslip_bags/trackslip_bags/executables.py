# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Entry point of the recorder: it loads its module only when called (see ``start``)."""

from trackslip_common.start import start


def record() -> None:
    """See ``trackslip_bags.nodes.record``."""
    start("trackslip_bags.nodes.record")
