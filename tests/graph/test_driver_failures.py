# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""An exception in a driver's own thread is counted and reported; the port stays open, and data go on."""

import queue
import time
from collections.abc import Iterator
from dataclasses import dataclass

import pytest
import rclpy
from rclpy.signals import SignalHandlerOptions

from trackslip_common.nodes.health import ERROR
from trackslip_common.parameters import Parameters
from trackslip_drivers.nodes.driver import DriverNode

PATIENCE_S = 20.0


@dataclass(frozen=True)
class NoParameters(Parameters):
    """Of a driver without any."""


class QueuePort:
    """Delivers what the test puts in."""

    note = ""

    def __init__(self) -> None:
        self.items: queue.Queue[bytes] = queue.Queue()

    def read(self):
        try:
            return [(self.items.get(timeout=0.05), time.time_ns())]
        except queue.Empty:
            return []

    def close(self) -> None:
        pass


class FragileDriver(DriverNode[NoParameters]):
    """Fails on the bytes ``bad``."""

    def __init__(self) -> None:
        super().__init__("fragile_driver", NoParameters)
        self.port, self.begun, self.received = QueuePort(), 0, []

    def open_port(self) -> QueuePort:
        return self.port

    def begin(self) -> None:
        self.begun += 1

    def receive(self, data: bytes, arrival_ns: int) -> None:
        if data == b"bad":
            raise ValueError("no such telegram")
        self.received.append(data)
        self.count()


@pytest.fixture
def driver(domain: int) -> Iterator[FragileDriver]:
    rclpy.init(args=[], domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
    node = FragileDriver()
    node.start()
    yield node
    node.end()
    node.destroy_node()
    rclpy.try_shutdown()


def test_exception_while_data_are_decoded_is_reported_and_the_driver_goes_on(driver):
    for data in (b"1", b"bad", b"2"):
        driver.port.items.put(data)
    give_up = time.monotonic() + PATIENCE_S
    while len(driver.received) < 2 and time.monotonic() < give_up:
        time.sleep(0.01)
    assert driver.received == [b"1", b"2"]
    assert driver.begun == 2  # at the opening, and so that nothing half decoded is left
    assert driver._link.state().openings == 1
    (entry,) = driver.callback_failures.health()
    assert entry.level == ERROR
    assert "received data: ValueError: no such telegram (test_driver_failures.py:" in entry.message
