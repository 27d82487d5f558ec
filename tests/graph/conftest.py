# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Processes, and a ROS node to watch them with, in a domain of their own."""

import fcntl
import os
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from fixtures.observer import Observer
from fixtures.plugged_devices import MULTICAST
from fixtures.programs import ROOT, Programs

_DOMAINS = range(1, 102)
_PARTICIPANTS = 20  # more than any of our graphs has


def _enter() -> None:
    """Set what ``make test`` sets, for a plain ``python -m pytest``."""
    script = '. "$0" && exec env -0'
    environment = ROOT / ".venv" / "trackslip.sh"
    if environment.is_file():
        output = subprocess.check_output(["sh", "-c", script, str(environment)], text=True)
        pairs = (entry.partition("=") for entry in output.split("\0") if entry)
        os.environ.update((name, value) for name, _, value in pairs)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"


_enter()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """``make test``, which runs other tests beside these, tries a failed one again and reports it."""
    if hasattr(config, "workerinput"):
        for item in items:
            if item.path.is_relative_to(Path(__file__).parent):
                item.add_marker(pytest.mark.flaky(reruns=1))


@pytest.fixture
def domain() -> Iterator[int]:
    """A domain that no other test and no running graph uses: locked among tests, its DDS ports free."""
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
    """Whether none of its first participants' unicast ports is taken (DDSI-RTPS 9.6.2).

    All of them: of a graph whose tests were killed the later ones may go on.
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


@pytest.fixture
def can(udp_port: int) -> dict[str, Any]:
    """Parameters of nodes on a CAN bus of this test alone, over UDP."""
    return {"can_interface": "udp_multicast", "can_channel": MULTICAST, "can_port": udp_port}
