# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A node that survives exceptions of its callbacks, and messages that the middleware does not send."""

from collections.abc import Callable
from typing import Any

from trackslip_common.nodes.failures import CallbackFailures, SendFailures
from trackslip_common.nodes.lifecycle import SelfStartingNode


class GuardedNode(SelfStartingNode):
    """Node with guarded callbacks of subscriptions, timers and services, rclpy's own services included."""

    def __init__(self, name: str) -> None:
        self.callback_failures = CallbackFailures(lambda text: self.get_logger().error(text))
        self.send_failures = SendFailures(lambda text: self.get_logger().warning(text))
        super().__init__(name)

    def count_send_failures(self, publisher: Any) -> Any:
        """The publisher, with failures to send counted."""
        return self.send_failures.count_send_failures(publisher)

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Callable[..., Any], *args: Any, **options: Any
    ) -> Any:
        """As in rclpy; exceptions of the callback are counted."""
        handles_data = topic != "/clock"
        guarded = self.callback_failures.guard(callback, topic, handles_data=handles_data)
        return super().create_subscription(msg_type, topic, guarded, *args, **options)

    def create_timer(self, period: float, callback: Callable[..., Any], *args: Any, **options: Any) -> Any:
        """As in rclpy; exceptions of the callback are counted."""
        guarded = self.callback_failures.guard(callback, f"timer {callback.__name__.strip('_')}")
        return super().create_timer(period, guarded, *args, **options)

    def create_service(
        self, srv_type: Any, srv_name: str, callback: Callable[..., Any], *args: Any, **options: Any
    ) -> Any:
        """As in rclpy; exceptions of the callback are counted, and the blank response is returned."""
        guarded = self.callback_failures.guard(callback, srv_name)

        def answer(request: Any, response: Any) -> Any:
            answered = guarded(request, response)
            if answered is None and hasattr(response, "message"):
                response.success, response.message = False, self.callback_failures.last
            return answered or response

        return super().create_service(srv_type, srv_name, answer, *args, **options)
