# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Entry points of the emulator and the demo: each loads its module only when called (see ``start``)."""

from trackslip_common.errors import ExitCode
from trackslip_common.start import start


def emulator() -> None:
    """See ``trackslip_sim.nodes.emulator``."""
    start("trackslip_sim.nodes.emulator")


def demo() -> None:
    """See ``trackslip_sim.demo.run``."""
    start("trackslip_sim.demo.run", ExitCode.INTERRUPTED)
