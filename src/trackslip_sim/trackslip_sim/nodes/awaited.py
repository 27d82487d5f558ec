# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Other nodes that must be active before this one goes on."""

import time
from collections.abc import Iterable
from typing import Any

from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from rclpy.node import Node

_LOST = 5.0  # s without an answer: the node is busy, or Fast DDS dropped it


class AwaitedNodes:
    """Asks lifecycle nodes of the same namespace for their states, without blocking."""

    def __init__(self, node: Node, names: Iterable[str]) -> None:
        self._node = node
        self._clients = {name: node.create_client(GetState, f"{name}/get_state") for name in names}
        self._asked: dict[str, tuple[Any, float]] = {}  # the answer to come, and when it was asked for

    @property
    def missing(self) -> list[str]:
        """Those not yet seen active."""
        return list(self._clients)

    def look(self) -> None:
        """Take the answers that have come, and ask those that are missing; to be called again and again."""
        for name in self.missing:
            answer, asked_s = self._asked.get(name, (None, 0.0))
            if answer is None:
                self._ask(name)
            elif answer.done():
                del self._asked[name]
                if answer.result().current_state.id == State.PRIMARY_STATE_ACTIVE:
                    self._node.destroy_client(self._clients.pop(name))
            elif time.monotonic() - asked_s > _LOST:
                self._clients[name].remove_pending_request(answer)
                del self._asked[name]

    def close(self) -> None:
        """Ask no more."""
        while self._clients:
            self._node.destroy_client(self._clients.popitem()[1])

    def _ask(self, name: str) -> None:
        client = self._clients[name]
        if client.service_is_ready():
            self._asked[name] = client.call_async(GetState.Request()), time.monotonic()
