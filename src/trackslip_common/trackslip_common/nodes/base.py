# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Base of all nodes: rejects invalid parameters, survives failures of callbacks, reports at 1 Hz."""

from collections.abc import Callable
from typing import Any, Generic, TypeVar

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from std_msgs.msg import String

from trackslip_common.compiling import report_compilation
from trackslip_common.config_files import parameters_text
from trackslip_common.errors import InputError
from trackslip_common.nodes import parameters as node_parameters
from trackslip_common.nodes.guarded import GuardedNode
from trackslip_common.nodes.health import OK, WARN, Health, StateLog, console_logger, diagnostics
from trackslip_common.nodes.inputs import Inputs
from trackslip_common.nodes.messages import packed_topic, type_name_of
from trackslip_common.nodes.outputs import PackedOutput
from trackslip_common.nodes.parameters import CommonParameters
from trackslip_common.nodes.qos import publisher_qos, subscriber_qos
from trackslip_common.packed import PackedMessage
from trackslip_common.parameters import Parameters, reloadable_names, to_flat
from trackslip_common.tally import Tally
from trackslip_common.topics import COMMANDS

P = TypeVar("P", bound=Parameters)


class TrackslipNode(GuardedNode, Generic[P]):
    """Base of all nodes.

    Subclasses override ``configure`` (create publishers, subscriptions, the core), ``activate`` and
    ``deactivate`` (open and close devices), ``reload``, and ``health``.

    Raises:
        InputError: a parameter is unknown, of a wrong type or out of range.
    """

    realtime_priority = 0  # default of the parameter
    parameters_topic = ""  # topic for the parameters in use; empty: none
    has_failed = False  # whether its work is incomplete; its process then ends with ExitCode.FAILED

    def __init__(self, name: str, parameters: type[P], *default_files: str) -> None:
        super().__init__(name)
        common = CommonParameters(autostart=True, realtime_priority=self.realtime_priority)
        records = node_parameters.read_overrides(self, name, common, parameters, default_files)
        self.what = name  # kind of node, independent of its ROS name
        self.common, self.settings = records
        for record in records:
            node_parameters.declare_parameters(self, record)
        self._settings_in_use: P = self.settings
        self.has_run = False  # whether the node was active since it was configured
        self.add_on_set_parameters_callback(self._on_set_parameters)
        self.tally = Tally()
        self._states = StateLog(console_logger(self.get_logger()))
        self.inputs = Inputs(self)
        self._status = self.count_send_failures(self.create_publisher(DiagnosticArray, "/diagnostics", 10))
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._permanent_timers.append(self.create_timer(1.0, self.publish_health, clock=steady))

    def reload(self, values: dict[str, Any]) -> None:
        """Pass changed parameters, by dotted name, to the core.

        Called while the node is active; changes made while it is inactive are passed at its activation.
        """

    def drain(self, spin_once: Callable[[], None]) -> None:
        """Before the end: handle messages that have arrived but are not handled yet, if that matters."""

    def health(self) -> list[Health]:
        """The entries for /diagnostics; called only while the node is active."""
        return [Health(OK, "running")]

    @property
    def full_name(self) -> str:
        """Name with the namespace."""
        return self.get_fully_qualified_name().removeprefix("/")

    def hardware(self) -> str:
        """Hardware of the node for /diagnostics: its device if it has one, else its name."""
        return self.full_name

    def start_inputs(self) -> dict[str, Any]:
        """Inputs of the node's start beside its parameters, by name, for the parameters' topic."""
        return {}

    def start(self) -> None:
        """Configure and activate, unless ``autostart`` is false; raises the errors of both."""
        if self.common.autostart:
            super().start()

    def subscribe(self, message_type: type, topic: str, callback: Callable[[Any], None]) -> None:
        """Subscribe; messages are dropped while the node is inactive, and beyond the rate limit."""
        self._subscribe(message_type, topic, callback, raw=False)

    def subscribe_packed(self, message_type: type, topic: str, callback: Callable[[Any], None]) -> None:
        """Subscribe to frequent messages; they stay serialized, for ``message_reading.read``."""
        packed = packed_topic(message_type)
        self._subscribe(message_type, topic, lambda raw: callback(PackedMessage(raw, packed)), raw=True)

    def _subscribe(
        self, message_type: type, topic: str, callback: Callable[[Any], None], *, raw: bool
    ) -> None:
        def when_active(message: Any) -> None:
            if self.active and self.inputs.accept_message(topic):
                callback(message)

        full_name = self._checked_name(message_type, topic)
        if any(output.topic_name == full_name for output in self._advertised):
            text = f"'{topic}' is {full_name}, which this node publishes; accepted: a topic of another node"
            raise InputError(f"{self.get_name()}: {text}")
        subscription = self.create_subscription(
            message_type, topic, when_active, subscriber_qos(topic), raw=raw
        )
        if topic not in COMMANDS:
            self.inputs.add(topic, subscription)

    def _checked_name(self, message_type: type, topic: str) -> str:
        """The full name of a topic.

        Raises:
            InputError: it is no name of a topic, or one with another type.
        """
        try:
            full_name: str = self.resolve_topic_name(topic)
        except (RuntimeError, ValueError):
            text = f"'{topic}' is no name of a topic; accepted: letters, digits, '_', and '/' between words"
            raise InputError(f"{self.get_name()}: {text}") from None
        for one in (*self._advertised, *self.subscriptions):
            if one.topic_name == full_name and one.msg_type is not message_type:
                text = f"'{topic}' is {full_name}, which is a {type_name_of(one.msg_type)} in this node"
                raise InputError(f"{self.get_name()}: {text}; accepted: a {type_name_of(message_type)}")
        return full_name

    def advertise(self, message_type: type, topic: str) -> Any:
        """A lifecycle publisher with the topic's own quality of service; failures to send are counted."""
        self._checked_name(message_type, topic)
        qos = publisher_qos(topic.removeprefix("/"))
        publisher = self.create_lifecycle_publisher(message_type, topic, qos)
        self._advertised.append(publisher)
        return self.count_send_failures(publisher)

    def advertise_packed(self, topic: str, blank: Any) -> PackedOutput:
        """A publisher of frequent messages, which equal ``blank`` except for their numbers."""
        return PackedOutput(self.advertise(type(blank), topic), blank)

    def publish_health(self) -> None:
        """Publish /diagnostics now; a timer does so once a second."""
        try:
            entries = self.health() if self.active else [Health(OK, "inactive")]
        except Exception as error:  # noqa: BLE001 (what failed is reported all the same)
            self.callback_failures.add("health", error)
            entries = []
        entries += self.inputs.health()
        if self.active:
            self._states.log_changes(entries)
        entries += [*self.callback_failures.health(), *self.send_failures.health()]  # these log themselves
        self._report(entries)

    def _report(self, entries: list[Health]) -> None:
        stamp = self.get_clock().now().to_msg()
        self._status.publish(diagnostics(self.full_name, stamp, entries, self.hardware()))

    def _report_compilation(self, text: str) -> None:
        if text:
            self._report([Health(WARN, text)])

    def _configure(self) -> None:
        self.inputs.clear()
        self._settings_in_use = self.settings
        self.has_run = False
        if self.parameters_topic:
            self._parameters_used = self.advertise(String, self.parameters_topic)
        with report_compilation(self.get_logger().info, self._report_compilation):
            self.configure()

    def _activate(self) -> None:
        self.publish_parameters()
        self._reload()
        self.has_run = True
        self.activate()

    def _on_set_parameters(self, parameters: list[Any]) -> SetParametersResult:
        """Accept changes of reloadable parameters; ROS itself rejects all others."""
        known = reloadable_names(self.settings)
        values = {p.name: p.value for p in parameters if p.name in known}
        before = self.settings
        try:
            self.settings = node_parameters.changed_record(before, values, self.get_name())
            if self.active and self.settings != before:
                self.publish_parameters()
                self._reload()
        except InputError as error:
            self.settings = before
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _reload(self) -> None:
        """Pass the parameters that differ from the core's to ``reload``."""
        values = node_parameters.differences(self._settings_in_use, self.settings)
        if values:
            self.reload(values)
        self._settings_in_use = self.settings

    def publish_parameters(self) -> None:
        """Publish the parameters of the estimates from now on; a bag records them."""
        if self.parameters_topic:
            text = parameters_text(to_flat(self.settings), self.what, **self.start_inputs())
            self._parameters_used.publish(String(data=text))
