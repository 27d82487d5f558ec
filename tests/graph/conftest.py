# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Fixtures: processes under test and a ROS node that observes them, in a ROS domain of their own."""

import fcntl
import os
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from fixtures.observer import Observer
from fixtures.plugged_devices import MULTICAST
from fixtures.programs import ROOT, Programs

from trackslip_sim.demo.run import free_udp_port

_DOMAINS = range(1, 102)
_PARTICIPANTS = 20  # more than any graph of the tests has


def _source_setup() -> None:
    """Set the environment of ``make test`` for a plain ``python -m pytest``."""
    script = '. "$0" && exec env -0'
    environment = ROOT / ".venv" / "trackslip.sh"
    if environment.is_file():
        output = subprocess.check_output(["sh", "-c", script, str(environment)], text=True)
        pairs = (entry.partition("=") for entry in output.split("\0") if entry)
        os.environ.update((name, value) for name, _, value in pairs)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"


_source_setup()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Repeat a failed test once under ``make test``, which runs other tests in parallel, and report it."""
    if hasattr(config, "workerinput"):
        for item in items:
            if item.path.is_relative_to(Path(__file__).parent):
                item.add_marker(pytest.mark.flaky(reruns=1))


@contextmanager
def free_domain() -> Iterator[int]:
    """A ROS domain that no other test and no running graph uses: locked among tests, its DDS ports free."""
    first = os.getpid() * 31 + time.monotonic_ns()
    with ExitStack() as locks:
        for offset in range(len(_DOMAINS)):
            number = _DOMAINS[(first + offset) % len(_DOMAINS)]
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


@pytest.fixture
def domain() -> Iterator[int]:
    """The domain of a test."""
    with free_domain() as number:
        yield number


def _is_silent(domain: int) -> bool:
    """Whether the unicast ports of the domain's first participants are free (DDSI-RTPS 9.6.2).

    All participants are checked: when tests are killed, only later ones may still be running.
    """
    for participant in range(_PARTICIPANTS):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", 7400 + 250 * domain + 10 + 2 * participant))
            except OSError:
                return False
    return True


@pytest.fixture
def programs(domain: int, tmp_path: Path) -> Iterator[Programs]:
    """Starts processes; kills the remaining ones at the end."""
    these = Programs(domain, tmp_path)
    yield these
    these.kill_all()


@pytest.fixture
def observer(domain: int, programs: Programs) -> Iterator[Observer]:
    """A node that watches and queries the processes."""
    this = Observer(domain, programs)
    yield this
    this.close()


@pytest.fixture(scope="module")
def shared_graph(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Programs, Observer]]:
    """Programs of a module, and a node that observes them, for tests that do not disturb each other."""
    with free_domain() as number:
        programs = Programs(number, tmp_path_factory.mktemp("graph"))
        observer = Observer(number, programs)
        yield programs, observer
        observer.close()
        programs.kill_all()


@pytest.fixture
def udp_port() -> int:
    """A free UDP port."""
    return free_udp_port()


@pytest.fixture
def can(udp_port: int) -> dict[str, Any]:
    """Parameters of nodes on a CAN bus over UDP that only this test uses."""
    return {"can_interface": "udp_multicast", "can_channel": MULTICAST, "can_port": udp_port}
