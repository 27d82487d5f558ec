# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""An exception in a callback does not end a node; parameters set while it is inactive reach its core."""

from pathlib import Path

from diagnostic_msgs.msg import DiagnosticStatus
from fixtures.observer import values_of
from rclpy.serialization import serialize_message
from std_srvs.srv import Trigger

from trackslip_common.nodes.messages import topic_class

SCRIPT = str(Path(__file__).with_name("fragile.py"))
CAUSE = "RuntimeError: requested by the test (fragile.py:"
NEVER = 1000.0  # s


class FragileNode:
    """The fragile node and the test's connections to it."""

    def __init__(self, programs, observer, duration=NEVER, fails=False, autostart=True):
        values = {"fails": fails, "duration": duration, "autostart": autostart}
        options = [part for name, value in values.items() for part in ("-p", f"{name}:={str(value).lower()}")]
        self.healths = observer.healths()
        self._observer = observer
        self.program = programs.python(SCRIPT, "--ros-args", *options)
        self.scans = observer.publisher("scan")
        if autostart and not fails:
            observer.wait_for_ends("scan", "observer", "fragile")
            observer.wait(self.running, "the node to run")

    def entries(self, name):
        """All reports of a part of the node: (level, message, values)."""
        reports = [h for h in self.healths if h.name == name]
        return [(h.level, h.message, values_of(h)) for h in reports]

    def running(self):
        """Values of the node's "running" reports."""
        return [values for _, message, values in self.entries("fragile") if message == "running"]

    def set(self, **values):
        (result,) = self._observer.set_parameters("fragile", **values)
        assert result.successful, result.reason

    def scan_until(self, condition, what):
        def publish_and_look():
            self.scans.publish(topic_class("scan")())
            return condition()

        self._observer.wait(publish_and_look, what)


def test_node_continues_after_exceptions_in_callbacks_and_reports_them(programs, observer):
    node = FragileNode(programs, observer)
    undecodable = topic_class("scan")()
    undecodable.header.frame_id = "XXXX"
    node.scans.publish(serialize_message(undecodable).replace(b"XXXX", b"\xff\xfe\xff\xfe"))
    node.scan_until(lambda: any(int(v["scans"]) > 0 for v in node.running()), "the scans after it")
    node.set(fails=True)
    answer = observer.ask(Trigger, "fragile/reset", Trigger.Request())
    assert not answer.success
    assert CAUSE in answer.message
    names = {f"failed: {name}" for name in ("scan", "timer on_timer", "~/reset", "health")}
    node.scan_until(
        lambda: any(names <= values.keys() for *_, values in node.entries("fragile: callbacks")), "all"
    )
    level, message, values = node.entries("fragile: callbacks")[-1]
    assert level == DiagnosticStatus.ERROR
    assert CAUSE in message
    assert CAUSE in values["last failure"]
    assert "age of the last failure (s)" in values
    node.set(fails=False)
    node.healths.clear()
    node.scan_until(lambda: any(int(v["scans"]) > 0 for v in node.running()), "scans to be handled again")
    assert node.program.end()[0] == 0
    lines = node.program.stderr.splitlines()
    assert len([line for line in lines if CAUSE in line]) == 4  # each cause once
    assert "Traceback" not in node.program.stderr


def test_uninterrupted_exceptions_end_the_node_with_one_line(programs, observer):
    node = FragileNode(programs, observer, duration=1.0, fails=True)
    assert node.program.wait() == 1
    last = node.program.stderr.splitlines()[-1]
    assert last.startswith("fragile: only failures; ")
    assert CAUSE in last
    assert "Traceback" not in node.program.stderr


def test_parameters_set_while_inactive_reach_the_core(programs, observer):
    """Before the first activation, and after a deactivation."""
    node, reloads = FragileNode(programs, observer, autostart=False), []
    assert observer.change("fragile", "configure")
    for transition in ("", "deactivate"):
        assert not transition or observer.change("fragile", transition)
        for fails in (True, False, True):  # back to the old value: no reload
            node.set(fails=fails)
        node.healths.clear()
        assert observer.change("fragile", "activate")
        observer.wait(lambda: node.entries("fragile: callbacks"), "the failures that the parameter asks for")
        node.set(fails=False)
        node.healths.clear()
        observer.wait(node.running, "the node to run")
        reloads += [{"fails": True}, {"fails": False}]
        assert node.running()[-1]["reloads"] == str(reloads)
