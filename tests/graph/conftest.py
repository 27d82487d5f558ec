# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Processes, and a ROS node to watch them with, in a domain of their own; all waits are on conditions."""

import fcntl
import math
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from fixtures.node_arguments import ros_arguments
from fixtures.patience import PATIENCE
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from trackslip_common.nodes.messages import topic_class
from trackslip_common.nodes.qos import publisher_qos, subscriber_qos

ROOT = Path(__file__).resolve().parents[2]
INSTALL = ROOT / "ros2_ws" / "install"
PACKAGE_OF = {
    **dict.fromkeys(
        ("can_driver", "watson_imu", "sick_pls", "nmea_gnss", "wheel_adapter"), "trackslip_drivers"
    ),
    **dict.fromkeys(("box_localizer", "gnss_localizer"), "trackslip_estimation"),
    **dict.fromkeys(("slip_estimator", "soil_estimator"), "trackslip_estimation"),
    "record": "trackslip_bags",
    **dict.fromkeys(("live", "trackslip"), "trackslip_tools"),
    "emulator": "trackslip_sim",
}
TRANSITIONS = {
    "configure": Transition.TRANSITION_CONFIGURE,
    "activate": Transition.TRANSITION_ACTIVATE,
    "deactivate": Transition.TRANSITION_DEACTIVATE,
    "cleanup": Transition.TRANSITION_CLEANUP,
}
_POLL = 0.005  # s
_MARK = "TRACKSLIP_TEST"  # variable in the environment of all that a test starts, directly or not
_DOMAINS = range(1, 102)
_ANSWER = 10.0  # s after which a service is asked again


def _enter() -> None:
    """Set what ``make test`` sets, for a plain ``python -m pytest``."""
    script = '. "$0" && exec env -0'
    environment = ROOT / ".venv" / "trackslip.sh"
    if environment.is_file():
        output = subprocess.check_output(["sh", "-c", script, str(environment)], text=True)
        os.environ.update(entry.split("=", 1) for entry in output.split("\0") if entry)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"


_enter()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """``make test``, which runs other tests beside these, tries a failed one again and reports it."""
    if hasattr(config, "workerinput"):
        for item in items:
            if item.path.is_relative_to(Path(__file__).parent):
                item.add_marker(pytest.mark.flaky(reruns=1))


class Program:
    """One process, leader of its own group, and what it writes."""

    def __init__(self, arguments: list[str], environment: dict[str, str], folder: Path) -> None:
        self.asked = False  # to end
        self._out, self._err = (folder / f"{uuid.uuid4().hex}.{name}" for name in ("out", "err"))
        with self._out.open("wb") as out, self._err.open("wb") as err:
            self.process = subprocess.Popen(
                arguments,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                cwd=folder,
                env=environment,
                start_new_session=True,
            )

    @property
    def stdout(self) -> str:
        return self._out.read_text(encoding="utf-8")

    @property
    def stderr(self) -> str:
        return self._err.read_text(encoding="utf-8")

    def wait(self, deadline: float = PATIENCE) -> int:
        """Exit code."""
        self.asked = True
        return self.process.wait(deadline)

    def end(self, number: int = signal.SIGINT) -> tuple[int, float]:
        """Signal it; exit code, and how long it took to end."""
        self.asked = True
        began = time.monotonic()
        self.process.send_signal(number)
        return self.wait(), time.monotonic() - began

    def until(self, condition: Callable[[], Any], what: str) -> None:
        """Wait while it runs."""
        give_up = time.monotonic() + PATIENCE
        while not condition():
            ended = (
                f"ended with {self.process.returncode}: {self.stderr}"
                if self.process.poll() is not None
                else ""
            )
            if ended or time.monotonic() > give_up:
                pytest.fail(f"waited for {what}; {ended or self.stdout}")
            time.sleep(_POLL)

    def has_loaded(self, library: str) -> bool:
        """Whether a file whose path has this in it is mapped into the process."""
        try:
            return library in Path(f"/proc/{self.process.pid}/maps").read_text(encoding="utf-8")
        except OSError:
            return False


class Programs:
    """Starts programs in the test's domain, and leaves none behind."""

    def __init__(self, domain: int, folder: Path) -> None:
        self.folder = folder
        self._started: list[Program] = []
        self._mark = uuid.uuid4().hex
        self.environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), _MARK: self._mark}

    def node(self, executable: str, *arguments: str, **parameters: Any) -> Program:
        """An executable of ours with ROS parameters."""
        return self.tool(executable, *ros_arguments(*arguments, **parameters))

    def tool(self, executable: str, *arguments: str) -> Program:
        """An executable of ours with these arguments."""
        return self.start(self.path(executable), *arguments)

    def path(self, executable: str) -> str:
        """Where one of ours is."""
        package = PACKAGE_OF[executable]
        return str(INSTALL / package / "lib" / package / executable)

    def python(self, *arguments: str) -> Program:
        """Python with these arguments."""
        return self.start(sys.executable, *arguments)

    def start(self, *arguments: str) -> Program:
        """Any command."""
        self._started.append(Program(list(arguments), self.environment, self.folder))
        return self._started[-1]

    def surprise(self) -> str:
        """The output of a program that ended unasked; empty where all run."""
        ended = [p for p in self._started if not p.asked and p.process.poll() is not None]
        return "".join(f"{p.process.args} ended with {p.process.returncode}: {p.stderr}" for p in ended)

    def alive(self) -> dict[int, str]:
        """Command lines, by pid, of all that descends from what this test started."""
        found = {}
        for process in Path("/proc").glob("[0-9]*"):
            try:
                if f"{_MARK}={self._mark}".encode() in (process / "environ").read_bytes().split(b"\0"):
                    command = (process / "cmdline").read_bytes().replace(b"\0", b" ").decode()
                    found[int(process.name)] = command
            except OSError:
                continue  # ended meanwhile, or not ours
        return found

    def kill_all(self) -> None:
        """Whatever is left."""
        give_up = time.monotonic() + PATIENCE
        while (left := self.alive()) and time.monotonic() < give_up:
            for pid in left:
                try:
                    os.kill(pid, signal.SIGKILL)
                except ProcessLookupError:
                    continue
            time.sleep(_POLL)


class Observer:
    """A node in this process; its messages are handled while ``wait`` waits."""

    def __init__(self, domain: int, programs: Programs) -> None:
        self._programs = programs
        self._context = Context()
        rclpy.init(
            args=[], context=self._context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO
        )
        self.node = rclpy.create_node("observer", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._publishers: dict[str, list[Any]] = {}  # by full topic name

    def close(self) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def wait(self, condition: Callable[[], Any], what: str, deadline: float = PATIENCE) -> None:
        """Handle messages until the condition holds; all programs must run meanwhile."""
        give_up = time.monotonic() + deadline
        while not condition():
            surprise = self._programs.surprise()
            if surprise or time.monotonic() > give_up:
                pytest.fail(f"waited for {what}; {surprise or 'too long'}")
            self._executor.spin_once(timeout_sec=0.05)

    def subscribe(self, topic: str, as_topic: str | None = None) -> list[Any]:
        """The list that the messages of a project topic, or of another one of the same kind, will be in."""
        received: list[Any] = []
        kind = as_topic or topic
        self.node.create_subscription(topic_class(kind), topic, received.append, subscriber_qos(kind))
        return received

    def healths(self) -> list[Any]:
        """The list that all entries of /diagnostics will be in."""
        received: list[Any] = []
        self.node.create_subscription(
            DiagnosticArray, "/diagnostics", lambda message: received.extend(message.status), 100
        )
        return received

    def publisher(self, topic: str, as_topic: str | None = None) -> Any:
        """A publisher of a project topic, or of another one of the same kind."""
        kind = as_topic or topic
        publisher = self.node.create_publisher(topic_class(kind), topic, publisher_qos(kind))
        self._publishers.setdefault(publisher.topic_name, []).append(publisher)
        return publisher

    def wait_for_ends(self, topic: str, *nodes: str) -> None:
        """Until these nodes publish the topic or subscribe to it, and publishers of this node send to all.

        The graph knows a subscriber before a publisher has matched it, and what is sent until then is lost.
        """
        name = self.node.resolve_topic_name(topic)

        def all_there() -> bool:
            subscribers = self.node.get_subscriptions_info_by_topic(name)
            ends = [*self.node.get_publishers_info_by_topic(name), *subscribers]
            matched = [publisher.get_subscription_count() for publisher in self._publishers.get(name, [])]
            return set(nodes) <= {end.node_name for end in ends} and all(
                count >= len(subscribers) for count in matched
            )

        self.wait(all_there, f"{nodes} on {topic}")

    def wait_for_recorder(self, healths: list[Any], *topics: str, recorder: str = "record") -> None:
        """Until a recorder itself has found a publisher of each of these topics."""

        def found() -> bool:
            reports = [health for health in healths if health.name == f"{recorder}: publishers"][-1:]
            counts = {pair.key: int(pair.value) for health in reports for pair in health.values}
            return all(counts.get(f"/{topic}", 0) > 0 for topic in topics)

        self.wait(found, f"the recorder to find {', '.join(topics)}")

    def state(self, node: str) -> str:
        """Label of a node's lifecycle state; asked again, as a killed one may get the question."""
        answer = self._ask(GetState, f"{node}/get_state", GetState.Request(), patience=_ANSWER)
        label: str = answer.current_state.label
        return label

    def change(self, node: str, transition: str) -> bool:
        """Ask for a transition; whether it succeeded."""
        request = ChangeState.Request(transition=Transition(id=TRANSITIONS[transition]))
        return bool(self._ask(ChangeState, f"{node}/change_state", request).success)

    def _ask(self, service: Any, name: str, request: Any, patience: float = math.inf) -> Any:
        client = self.node.create_client(service, name)
        questions: list[Any] = []
        due = 0.0

        def is_answered() -> bool:
            nonlocal due
            if client.service_is_ready() and time.monotonic() >= due:
                questions.append(client.call_async(request))
                due = time.monotonic() + patience
            return any(question.done() for question in questions)

        try:
            self.wait(is_answered, f"an answer of {name}")
            return next(question.result() for question in questions if question.done())
        finally:
            self.node.destroy_client(client)


@pytest.fixture
def domain() -> Iterator[int]:
    """A domain that no other test and no running graph uses: locked among tests, its first DDS port free."""
    with ExitStack() as locks:
        for offset in range(len(_DOMAINS)):
            number = _DOMAINS[(os.getpid() * 31 + time.monotonic_ns() + offset) % len(_DOMAINS)]
            path = Path(tempfile.gettempdir()) / f"trackslip_test_domain_{number}.lock"
            lock = locks.enter_context(path.open("a"))
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                continue
            if _is_silent(number):
                yield number
                return
        pytest.fail("no ROS domain is free")


def _is_silent(domain: int) -> bool:
    """Whether no participant has the unicast port of the domain's first one (DDSI-RTPS 9.6.2)."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("", 7400 + 250 * domain + 10))
        except OSError:
            return False
    return True


@pytest.fixture
def programs(domain: int, tmp_path: Path) -> Iterator[Programs]:
    """To start processes; what is left of them at the end is killed."""
    these = Programs(domain, tmp_path)
    yield these
    these.kill_all()


@pytest.fixture
def observer(domain: int, programs: Programs) -> Iterator[Observer]:
    """To watch and to ask them."""
    this = Observer(domain, programs)
    yield this
    this.close()


@pytest.fixture
def udp_port() -> int:
    """One that nobody uses."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        port: int = probe.getsockname()[1]
        return port
