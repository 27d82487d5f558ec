# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A node that compiles reports so, with the elapsed time."""

import re
import time
from typing import Any

import pytest
from fixtures.own_node import NoParameters, own_node
from numba.core import event

from trackslip_common.nodes.base import TrackslipNode
from trackslip_common.nodes.health import WARN


class Compiling(TrackslipNode[NoParameters]):
    """A node that compiles a kernel when it is first configured."""

    def __init__(self) -> None:
        super().__init__("compiling", NoParameters)
        self.is_compiled = False
        self.sent: list[Any] = []
        self._status.publish = self.sent.append

    def configure(self) -> None:
        """Compile for a while, with numba's compile event."""
        if not self.is_compiled:
            with event.trigger_event("numba:compile"):
                time.sleep(1.5)
        self.is_compiled = True


@pytest.fixture
def node(domain: int) -> Any:
    with own_node(Compiling, domain) as made:
        yield made


def test_a_node_that_compiles_reports_it_until_it_is_done(node: Compiling) -> None:
    node.start()
    reported = [status for array in node.sent for status in array.status]
    assert len(reported) >= 2
    assert {(status.name, status.level) for status in reported} == {("compiling", WARN)}
    assert all(re.match(r"compiling, about \d+ s left", status.message) for status in reported)
    node.sent.clear()
    node.trigger_deactivate()
    node.trigger_cleanup()
    node.trigger_configure()  # nothing left to compile
    assert node.sent == []
