# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Lifecycles of other nodes: one is changed from here, several are awaited."""

import time
from collections.abc import Iterable
from typing import Any

from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.executors import Executor
from rclpy.node import Node

_LOST = 5.0  # s without an answer, after which it may have been lost


class RemoteLifecycle:
    """Asks ``name`` for transitions, through a node and the executor that handles it.

    Answers get lost: Fast DDS drops one where the other node, on a busy machine, has not yet found the end
    to send it to.
    """

    def __init__(self, node: Node, executor: Executor, name: str) -> None:
        self._executor = executor
        self._changes = node.create_client(ChangeState, f"{name}/change_state")
        self._states = node.create_client(GetState, f"{name}/get_state")
        self._asked: Any = None
        self._asked_s = 0.0
        self._is_uncertain = False  # whether the last transition was made

    def bring(self, transition: int, state: int, timeout: float) -> bool:
        """Make the transition, which leads to ``state`` (their ids); False if that is not (yet) so.

        To be called until it is. Later calls wait for the same answer; if none comes, they ask for the state.
        """
        if self._asked is None and not self._ask(transition, timeout):
            return False
        self._executor.spin_until_future_complete(self._asked, timeout_sec=timeout)
        if not self._asked.done():
            if time.monotonic() - self._asked_s > _LOST:
                self._asked, self._is_uncertain = None, True
            return False
        answer, self._asked, self._is_uncertain = self._asked.result(), None, False
        if isinstance(answer, GetState.Response):
            return bool(answer.current_state.id == state)
        return bool(answer.success)

    def _ask(self, transition: int, timeout: float) -> bool:
        """Whether there was somebody to ask."""
        client = self._states if self._is_uncertain else self._changes
        if not client.wait_for_service(timeout_sec=timeout):
            return False
        request = ChangeState.Request(transition=Transition(id=transition))
        self._asked = client.call_async(GetState.Request() if self._is_uncertain else request)
        self._asked_s = time.monotonic()
        return True


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
