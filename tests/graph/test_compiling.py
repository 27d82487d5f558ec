# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A node that compiles says so: it was silent for the first minute after an installation."""

import time
from typing import Any

import numba
import pytest
from fixtures.own_node import NoParameters, own_node

from trackslip_common.compiling import TEXT
from trackslip_common.nodes.base import TrackslipNode
from trackslip_common.nodes.health import WARN


class Compiling(TrackslipNode[NoParameters]):
    """Its kernel is compiled when it is configured for the first time."""

    def __init__(self) -> None:
        super().__init__("compiling", NoParameters)
        self.kernel = numba.njit(lambda x: x + 1.0)
        self.sent: list[Any] = []
        self._status.publish = self.sent.append

    def configure(self) -> None:
        """Compile, and stay a while."""
        if not self.kernel.signatures:
            self.kernel(1.0)
            time.sleep(1.5)


@pytest.fixture
def node(domain: int) -> Any:
    with own_node(Compiling, domain) as made:
        yield made


def test_a_node_that_compiles_reports_it_until_it_is_done(node: Compiling) -> None:
    node.start()
    told = [status for array in node.sent for status in array.status]
    assert len(told) >= 2
    assert {(status.name, status.level, status.message) for status in told} == {("compiling", WARN, TEXT)}
    node.sent.clear()
    node.trigger_deactivate()
    node.trigger_cleanup()
    node.trigger_configure()  # now there is nothing to compile
    assert node.sent == []
