# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Lifecycle states of other nodes: changes one, awaits several."""

import time
from collections.abc import Iterable
from typing import Any

from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.executors import Executor
from rclpy.node import Node

_ANSWER_TIMEOUT = 5.0  # s without an answer, after which it counts as lost


class RemoteLifecycle:
    """Requests transitions of the node ``name``, through a node and its executor.

    Answers can be lost: Fast DDS drops an answer if the other node, on a busy machine, has not yet
    discovered the endpoint.
    """

    def __init__(self, node: Node, executor: Executor, name: str) -> None:
        self._executor = executor
        self._changes = node.create_client(ChangeState, f"{name}/change_state")
        self._states = node.create_client(GetState, f"{name}/get_state")
        self._pending: Any = None
        self._request_s = 0.0
        self._is_uncertain = False  # the answer to the last transition was lost

    def request_transition(self, transition: int, state: int, timeout: float) -> bool:
        """Request the transition to ``state`` (both are ids); False if not (yet) done.

        Call until True. Later calls wait for the same answer; if it is lost, they request the state.
        """
        if self._pending is None and not self._send_request(transition, timeout):
            return False
        self._executor.spin_until_future_complete(self._pending, timeout_sec=timeout)
        if not self._pending.done():
            if time.monotonic() - self._request_s > _ANSWER_TIMEOUT:
                self._pending, self._is_uncertain = None, True
            return False
        answer, self._pending, self._is_uncertain = self._pending.result(), None, False
        if isinstance(answer, GetState.Response):
            return bool(answer.current_state.id == state)
        return bool(answer.success)

    def _send_request(self, transition: int, timeout: float) -> bool:
        """Send the request; False if the service is not available."""
        client = self._states if self._is_uncertain else self._changes
        if not client.wait_for_service(timeout_sec=timeout):
            return False
        request = ChangeState.Request(transition=Transition(id=transition))
        self._pending = client.call_async(GetState.Request() if self._is_uncertain else request)
        self._request_s = time.monotonic()
        return True


class AwaitedNodes:
    """Requests the states of lifecycle nodes of the same namespace, without blocking."""

    def __init__(self, node: Node, names: Iterable[str]) -> None:
        self._node = node
        self._clients = {name: node.create_client(GetState, f"{name}/get_state") for name in names}
        self._pending: dict[str, tuple[Any, float]] = {}  # pending answer, and time of the request

    @property
    def missing(self) -> list[str]:
        """Names of the nodes not yet active."""
        return list(self._clients)

    def poll(self) -> None:
        """Process received answers and request missing ones; call repeatedly."""
        for name in self.missing:
            answer, request_s = self._pending.get(name, (None, 0.0))
            if answer is None:
                self._send_request(name)
            elif answer.done():
                del self._pending[name]
                if answer.result().current_state.id == State.PRIMARY_STATE_ACTIVE:
                    self._node.destroy_client(self._clients.pop(name))
            elif time.monotonic() - request_s > _ANSWER_TIMEOUT:
                self._clients[name].remove_pending_request(answer)
                del self._pending[name]

    def close(self) -> None:
        """Stop all requests."""
        while self._clients:
            self._node.destroy_client(self._clients.popitem()[1])

    def _send_request(self, name: str) -> None:
        client = self._clients[name]
        if client.service_is_ready():
            self._pending[name] = client.call_async(GetState.Request()), time.monotonic()
