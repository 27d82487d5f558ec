# SPDX-License-Identifier: Apache-2.0
"""What all nodes are: a lifecycle node that starts by itself, refuses bad parameters, and reports at 1 Hz."""

import traceback
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.clock import Clock, ClockType
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from trackslip_common.config_files import node_defaults
from trackslip_common.errors import InputError
from trackslip_common.nodes.qos import publisher_qos, subscriber_qos
from trackslip_common.parameters import Parameters, Spec, flat_fields, from_flat, parameter, to_flat
from trackslip_common.tally import Tally

P = TypeVar("P", bound=Parameters)

_ROS_OWN = ("use_sim_time", "start_type_description_service", "qos_overrides.")
_COMPLAINT_PERIOD = 30.0  # s between words in the log about the same trouble

OK, WARN, ERROR, STALE = (
    DiagnosticStatus.OK,
    DiagnosticStatus.WARN,
    DiagnosticStatus.ERROR,
    DiagnosticStatus.STALE,
)


@dataclass(frozen=True)
class Health:
    """One line of /diagnostics."""

    level: bytes
    message: str
    values: dict[str, Any] = field(default_factory=dict)
    part: str = ""  # of the node; empty for the node itself


@dataclass(frozen=True, kw_only=True)
class CommonParameters(Parameters):
    """What every node takes beside its own."""

    autostart: bool = parameter("configure and activate without being asked")
    realtime_priority: int = parameter("of SCHED_FIFO, where the host allows it; 0: as others", ge=0, le=99)


class TrackslipNode(LifecycleNode, Generic[P]):
    """Base of all nodes.

    Subclasses override ``configure`` (make publishers, subscriptions, the core), ``activate`` and
    ``deactivate`` (open and close devices), and ``health``.

    Raises:
        InputError: a parameter is unknown, of a wrong type or out of range.
    """

    realtime_priority = 0  # by default

    def __init__(self, name: str, parameters: type[P], *default_files: str) -> None:
        super().__init__(name, automatically_declare_parameters_from_overrides=True)
        self.settings: P = self._declare(parameters, default_files)
        self.tally = Tally()
        self.active = False
        self._starting = False
        self._failure: Exception | None = None
        self._advertised: list[Any] = []
        self._unsent: Counter[str] = Counter()  # by topic
        self._unsent_told = 0
        self._status = self.tolerate_failures(self.create_publisher(DiagnosticArray, "/diagnostics", 10))
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._pulse = self.create_timer(1.0, self.publish_health, clock=steady)

    def configure(self) -> None:
        """Make what the node needs; devices stay closed."""

    def activate(self) -> None:
        """Begin to work."""

    def deactivate(self) -> None:
        """Stop, so that ``activate`` can begin again; also called at the end, and if ``activate`` fails."""

    def release(self) -> None:
        """Give back what ``configure`` took beside publishers, subscriptions, timers; safe to call twice."""

    def drain(self, spin_once: Callable[[], None]) -> None:
        """Before the end: take what has arrived but was not handled yet, if that matters."""

    def health(self) -> list[Health]:
        """What /diagnostics shall say; asked only while the node is active."""
        return [Health(OK, "running")]

    def subscribe(self, message_type: type, topic: str, callback: Callable[[Any], None]) -> None:
        """Subscribe; messages that come while the node is inactive are not for it."""

        def when_active(message: Any) -> None:
            if self.active:
                callback(message)

        self.create_subscription(message_type, topic, when_active, subscriber_qos(topic))

    def advertise(self, message_type: type, topic: str) -> Any:
        """A lifecycle publisher with the topic's own quality of service, whose failures the node outlives."""
        publisher = self.create_lifecycle_publisher(
            message_type, topic, publisher_qos(topic.removeprefix("/"))
        )
        self._advertised.append(publisher)
        return self.tolerate_failures(publisher)

    def tolerate_failures(self, publisher: Any) -> Any:
        """The publisher; what it cannot send is counted: one stalled subscriber is no reason to end."""
        send = publisher.publish

        def publish(message: Any) -> None:
            try:
                send(message)
            except rclpy_implementation.RCLError as error:
                self._unsent[publisher.topic_name] += 1
                text = f"{publisher.topic_name}: not sent: {' '.join(str(error).split())}"
                self.get_logger().warning(text, throttle_duration_sec=_COMPLAINT_PERIOD)

        publisher.publish = publish
        return publisher

    def start(self) -> None:
        """Configure and activate, unless ``autostart`` is false.

        Raises:
            InputError: ``configure`` or ``activate`` refused something that the user gave.
            Exception: whatever else they raised.
        """
        if not self.common.autostart:
            return
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
        """Stop, and give back all that was taken."""
        self.stop()
        self.release()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition."""
        outcome = self._attempt(self.configure)
        if outcome is not TransitionCallbackReturn.SUCCESS:
            self._undo()
            return outcome
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition."""
        super().on_activate(state)
        self.active = True
        outcome = self._attempt(self.activate)
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
        self._undo()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition."""
        self._attempt(self.end)
        return super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition, after an error that no user caused: back to before ``configure``."""
        self._undo()
        return super().on_error(state)

    def drop_subscriptions(self) -> None:
        """Hear nothing more."""
        for subscription in list(self.subscriptions):
            if subscription.topic_name != "/clock":
                self.destroy_subscription(subscription)

    def _attempt(self, work: Callable[[], None]) -> TransitionCallbackReturn:
        """The work of a transition; rclpy would swallow its error, which is for ``start`` or the log."""
        try:
            work()
        except (InputError, OSError) as error:
            known = isinstance(error, InputError)
            self._failure = error if known else InputError(f"{self.get_name()}: {error}")
            if not self._starting:
                self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        except Exception as error:  # noqa: BLE001 (an error of ours: told in full, and the transition fails)
            self._failure = error
            if not self._starting:
                self.get_logger().error(traceback.format_exc())
            return TransitionCallbackReturn.ERROR
        return TransitionCallbackReturn.SUCCESS

    def _undo(self) -> None:
        """Undo ``configure``, as far as it came."""
        self.drop_subscriptions()
        for timer in list(self.timers):
            if timer is not self._pulse:
                self.destroy_timer(timer)
        while self._advertised:
            self.destroy_lifecycle_publisher(self._advertised.pop())
        self._attempt(self.release)

    def _LifecycleNodeMixin__change_state(self, transition_id: int) -> TransitionCallbackReturn:
        """rclpy's own, but that an impossible transition is answered: in Jazzy it would end the process."""
        try:
            return super()._LifecycleNodeMixin__change_state(transition_id)
        except rclpy_implementation.RCLError as error:
            self.get_logger().error(" ".join(str(error).split()))
            return TransitionCallbackReturn.ERROR

    def _sending(self) -> list[Health]:
        """What could not be sent, by topic; nothing where that never happened."""
        unsent = dict(self._unsent)
        news, self._unsent_told = sum(unsent.values()) - self._unsent_told, sum(unsent.values())
        if not unsent:
            return []
        level, message = (WARN, f"{news} messages could not be sent") if news else (OK, "running")
        return [Health(level, message, {f"not sent: {topic}": n for topic, n in unsent.items()}, "outputs")]

    def _declare(self, parameters: type[P], default_files: tuple[str, ...]) -> P:
        """Defaults of ``config/``, what the user gave on top, checked, then declared to ROS."""
        name = self.get_name()
        given = {
            key: entry.value
            for key, entry in self.get_parameters_by_prefix("").items()
            if not key.startswith(_ROS_OWN)
        }
        for key in given:
            self.undeclare_parameter(key)
        common = {"autostart": True, "realtime_priority": self.realtime_priority}
        common |= {key: given.pop(key) for key in common.keys() & given.keys()}
        self.common = from_flat(CommonParameters, common, name)
        record = from_flat(parameters, node_defaults(name, *default_files) | given, name)
        for kind, values in ((CommonParameters, to_flat(self.common)), (parameters, to_flat(record))):
            for key, type_, spec in flat_fields(kind):
                self.declare_parameter(key, values[key], _descriptor(type_, spec), ignore_override=True)
        return record

    def publish_health(self) -> None:
        """Tell /diagnostics now; it is told once a second anyway."""
        array = DiagnosticArray()
        array.header.stamp = self.get_clock().now().to_msg()
        for entry in [*(self.health() if self.active else [Health(OK, "inactive")]), *self._sending()]:
            status = DiagnosticStatus(level=entry.level, message=entry.message, hardware_id=self.get_name())
            status.name = f"{self.get_name()}: {entry.part}" if entry.part else self.get_name()
            status.values = [KeyValue(key=k, value=str(v)) for k, v in entry.values.items()]
            array.status.append(status)
        self._status.publish(array)


def _descriptor(kind: Any, spec: Spec) -> ParameterDescriptor:
    """What ``ros2 param describe`` shows."""
    unit = f" [{spec.unit}]" if spec.unit else ""
    descriptor = ParameterDescriptor(description=spec.description + unit, read_only=spec.read_only)
    descriptor.additional_constraints = spec.accepted()
    low = spec.ge if spec.ge is not None else spec.gt
    high = spec.le if spec.le is not None else spec.lt
    if kind is float and (low is not None or high is not None):
        low, high = (-1e300 if low is None else low), (1e300 if high is None else high)
        descriptor.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high))]
    if kind is int and (low is not None or high is not None):
        first, last = (-(2**62) if low is None else int(low)), (2**62 if high is None else int(high))
        descriptor.integer_range = [IntegerRange(from_value=first, to_value=last)]
    return descriptor
