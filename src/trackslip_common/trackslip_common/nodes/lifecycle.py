# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A lifecycle node that starts by itself; a failed transition leaves it in its previous state."""

from collections.abc import Callable
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from trackslip_common.errors import InputError
from trackslip_common.nodes.failures import describe_exception


class SelfStartingNode(LifecycleNode):
    """Subclasses override ``configure``, ``activate``, ``deactivate`` and ``release``."""

    def __init__(self, name: str) -> None:
        self.active = False
        self._starting = False
        self._failure: Exception | None = None
        self._permanent_timers: list[Any] = []  # timers that outlive a clean-up
        self._advertised: list[Any] = []
        super().__init__(name, automatically_declare_parameters_from_overrides=True)

    def configure(self) -> None:
        """Create what the node needs; devices stay closed."""

    def activate(self) -> None:
        """Begin to work."""

    def deactivate(self) -> None:
        """Stop, so that ``activate`` can begin again; also called at the end, and if ``activate`` fails."""

    def release(self) -> None:
        """Release resources of ``configure`` beside publishers, subscriptions, timers; safe to call twice."""

    def start(self) -> None:
        """Configure and activate.

        Raises:
            InputError: ``configure`` or ``activate`` rejected user input.
            Exception: any other error of these.
        """
        self._starting = True
        for transition in (self.trigger_configure, self.trigger_activate):
            transition()
            if self._failure is not None:
                raise self._failure
        self._starting = False

    def stop(self) -> None:
        """Leave the active state; safe to call twice."""
        if self.active:
            self.active = False
            self.deactivate()

    def end(self) -> None:
        """Stop, and release all that was acquired."""
        self._attempt(self.stop)
        self._attempt(self.release)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition."""
        outcome = self._attempt(self._configure)
        if outcome is not TransitionCallbackReturn.SUCCESS:
            self._undo_configure()
            return outcome
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition."""
        super().on_activate(state)
        self.active = True
        outcome = self._attempt(self._activate)
        if outcome is not TransitionCallbackReturn.SUCCESS:
            self._attempt(self.stop)
            super().on_deactivate(state)
        return outcome

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition."""
        outcome = self._attempt(self.stop)
        super().on_deactivate(state)
        return outcome

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition: back to before ``configure``."""
        self._undo_configure()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition."""
        self.end()
        return super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition after an internal error: back to before ``configure``."""
        self._undo_configure()
        return super().on_error(state)

    def drop_subscriptions(self) -> None:
        """Destroy all subscriptions except /clock."""
        for subscription in list(self.subscriptions):
            if subscription.topic_name != "/clock":
                self.destroy_subscription(subscription)

    def _configure(self) -> None:
        """Call ``configure``; base classes add to it."""
        self.configure()

    def _activate(self) -> None:
        """Call ``activate``; base classes add to it."""
        self.activate()

    def _attempt(self, work: Callable[[], None]) -> TransitionCallbackReturn:
        """Do the work of a transition; its error, which rclpy would discard, goes to ``start`` or the log."""
        try:
            work()
        except (InputError, OSError) as error:
            is_input_error = isinstance(error, InputError)
            self._failure = error if is_input_error else InputError(f"{self.get_name()}: {error}")
            if not self._starting:
                self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        except Exception as error:  # noqa: BLE001 (a defect of ours: logged, and the transition fails)
            self._failure = error
            if not self._starting:
                self.get_logger().error(describe_exception(error))
            return TransitionCallbackReturn.ERROR
        return TransitionCallbackReturn.SUCCESS

    def _undo_configure(self) -> None:
        """Undo ``configure``, even if it was incomplete."""
        self.drop_subscriptions()
        for timer in list(self.timers):
            if timer not in self._permanent_timers:
                self.destroy_timer(timer)
        while self._advertised:
            self.destroy_lifecycle_publisher(self._advertised.pop())
        self._attempt(self.release)

    def _LifecycleNodeMixin__change_state(self, transition_id: int) -> TransitionCallbackReturn:
        """As in rclpy, but an impossible transition returns an error: in Jazzy it would end the process."""
        try:
            return super()._LifecycleNodeMixin__change_state(transition_id)
        except rclpy_implementation.RCLError as error:
            self.get_logger().error(" ".join(str(error).split()))
            return TransitionCallbackReturn.ERROR
