# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What the CAN driver reports of an interface that is absent, down, or off the bus."""

import errno
import os
import socket

import can as python_can
import pytest
from fixtures.own_node import started
from fixtures.patience import wait_for

from trackslip_common.nodes.health import ERROR, STALE
from trackslip_drivers.nodes import can_driver
from trackslip_drivers.nodes.can_driver import CanDriverNode
from trackslip_drivers.protocols.can_frames import ERROR_FLAG
from trackslip_drivers.transports.can_bus import CanBus

SOCKETCAN = {"can_interface": "socketcan", "can_channel": "can7"}


@pytest.mark.parametrize(
    ("number", "remedy"),
    [
        (errno.EAFNOSUPPORT, "load CAN into the kernel: modprobe can_raw"),
        (errno.ENODEV, "(No such device); check the adapter and can_channel: ip link does not list can7"),
        (errno.ENETDOWN, "(Network is down); set it up, with the bitrate of the bus: ip link set can7 up "),
    ],
)
def test_interface_that_is_absent_or_down_has_its_own_remedy(domain, monkeypatch, number, remedy):
    def fail(*_args):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(can_driver, "CanBus", fail)
    with started(CanDriverNode, domain, **SOCKETCAN) as node:
        wait_for(lambda: node.link.state().errors)
        (health, *_) = node.health()
        assert health.level == ERROR
        assert remedy in health.message


def test_bus_off_is_named_with_its_remedy_until_frames_come_again(domain, monkeypatch):
    """Linux restarts a controller that is off only by restart-ms: a socket opened again receives nothing."""
    monkeypatch.setattr(can_driver, "CanBus", lambda _interface, channel, _: CanBus("virtual", channel, {}))
    with (
        started(CanDriverNode, domain, **SOCKETCAN) as node,
        python_can.Bus("can7", interface="virtual") as bus,
    ):

        def send(identifier, is_error):
            bus.send(python_can.Message(arbitration_id=identifier, is_error_frame=is_error, data=bytes(8)))

        wait_for(lambda: node.link.state().connected)
        send(0x40, True)
        wait_for(lambda: node.link.state().openings == 2)
        (health, *_) = node.health()
        assert health.level == STALE
        assert (
            "no frames (bus off); check power, wiring and bitrate, then: ip link set can7 " in health.message
        )
        send(0x12345, False)
        wait_for(lambda: "bus off" not in node.health()[0].message)


def test_gateway_that_cannot_be_reached_has_its_own_remedy(domain):
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        gateway = {
            "can_interface": "socketcand",
            "can_host": "127.0.0.1",
            "can_port": closed.getsockname()[1],
        }
        with started(CanDriverNode, domain, **gateway) as node:
            wait_for(lambda: node.link.state().errors)
            message = node.health()[0].message
    assert "(Connection refused); check can_host and can_port, and that socketcand runs there" in message


@pytest.mark.parametrize("interface", ["pcan", "kvaser", "vector", "gs_usb", "neovi"])
def test_interface_without_its_library_has_the_remedy_to_install_it(domain, interface):
    with started(CanDriverNode, domain, can_interface=interface, can_channel="0") as node:
        wait_for(lambda: node.link.state().errors)
        message = node.health()[0].message
    assert f"{interface} without its library" in message
    assert message.endswith(f"; install the library of {interface}, or set can_interface to socketcan")


def test_adapter_on_a_serial_port_that_is_absent_has_the_remedy_of_the_port(domain, tmp_path):
    with started(
        CanDriverNode, domain, can_interface="slcan", can_channel=str(tmp_path / "none"), can_bitrate=250000
    ) as node:
        wait_for(lambda: node.link.state().errors)
        assert "not connected (No such file or directory); check power and cable" in node.health()[0].message


def test_bus_off_ends_with_the_interface_being_set_down_and_up(domain, monkeypatch):
    """No frame may come for a while, as the machine is off."""
    monkeypatch.setattr(can_driver, "CanBus", lambda _interface, channel, _: CanBus("virtual", channel, {}))
    with started(CanDriverNode, domain, **SOCKETCAN) as node:
        node.receive((0x40 | ERROR_FLAG, bytes(8)), 0)
        node.link._note_error(OSError(errno.ENETDOWN, os.strerror(errno.ENETDOWN)))
        assert node.health()[0].values["bus state"] == "active"
