# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The driver node decodes an unknown bus from a DBC and a roles file alone."""

import math
import threading
import time

import pytest
from fixtures import unseen_bus
from fixtures.observer import last_values
from fixtures.own_node import started
from fixtures.patience import wait_for
from fixtures.plugged_devices import MULTICAST

from trackslip_common.nodes.health import OK, WARN
from trackslip_drivers.nodes.can_driver import CanDriverNode
from trackslip_drivers.protocols.can_frames import STANDARD_FLAG
from trackslip_drivers.transports.can_bus import CanBus


@pytest.fixture(autouse=True)
def only_fed_frames(monkeypatch):
    """The thread of the link opens an empty bus; it would restart the decoding between two fed frames."""
    monkeypatch.setattr(CanDriverNode, "restart_decoding", lambda _: None)


@pytest.fixture
def machine(can):
    """CAN parameters of an emulated machine that sends its frames in real time until the test ends."""
    stopping = threading.Event()
    bus = CanBus("udp_multicast", MULTICAST, {"port": can["can_port"], "hop_limit": 0})  # stays on this host

    def send_frames():
        begin_ns = time.time_ns()
        for sent in unseen_bus.frames(begin_ns, begin_ns + 600 * 1_000_000_000):
            if stopping.wait(max(sent.stamp_ns - time.time_ns(), 0) * 1e-9):
                return
            bus.write((sent.arbitration_id, sent.data))

    thread = threading.Thread(target=send_frames)
    thread.start()
    yield can
    stopping.set()
    thread.join()
    bus.close()


def test_unknown_machine_is_read_by_its_dbc_and_roles(real_time, programs, observer, machine):
    dbc, roles = unseen_bus.write(programs.folder)
    topics = {name: observer.subscribe(name) for name in ("sprockets", "hydraulics", "swing")}
    healths = observer.healths()
    programs.node("can_driver", dbc_file=str(dbc), roles_file=str(roles), **machine)
    observer.wait(lambda: len(topics["sprockets"]) >= 150 and len(topics["swing"]) >= 50, "messages")
    for message in topics["sprockets"][20:]:
        assert list(message.name) == ["left_sprocket", "right_sprocket"]
        assert tuple(message.velocity) == pytest.approx(unseen_bus.SPEEDS, abs=2e-3)
        assert all(map(math.isnan, message.position))
    for message in topics["hydraulics"]:
        assert (message.left_pressure, message.right_pressure) == pytest.approx(unseen_bus.PRESSURES, abs=1e4)
        assert (message.left_spool, message.right_spool) == pytest.approx(unseen_bus.SPOOLS)
        assert message.supply_pressure == pytest.approx(unseen_bus.SUPPLY)
    for message in topics["swing"]:
        assert list(message.name) == ["swing"]
        assert abs(message.position[0]) <= math.pi

    def reported(key):
        return float(last_values(healths, "can_driver").get(key, 0.0))

    observer.wait(lambda: reported("rate (Hz)") == pytest.approx(50.0, rel=0.3), "the rate of the sprockets")
    assert reported("frames without a role") > 10


def of_group(sent, source):
    """The frame in a parameter group of J1939, from a source address."""
    return sent._replace(arbitration_id=0x18FF0A00 | source) if len(sent.data) == 4 else sent


@pytest.mark.parametrize(
    ("sources", "ports", "level", "words"),
    [
        ((0x27,), True, OK, "running"),
        (
            (0x27,),
            False,
            WARN,
            "running; no hydraulics and no swing: frames 'TravelPorts' (0x182), 'Upper' (0x183) do not come",
        ),
        ((0x27, 0x28), True, WARN, "running; frame 'TravelFlow' comes from source addresses 0x27 and 0x28;"),
    ],
)
def test_frames_that_lack_or_have_two_senders_are_named(
    domain, can, tmp_path, monkeypatch, sources, ports, level, words
):
    """Sprockets alone are no running machine; those of two controllers would be mixed."""
    monkeypatch.setattr("trackslip_drivers.nodes.driver.REPORT_TIME", 0.0)  # of rejections at the start
    roles = unseen_bus.ROLES + "frames: {TravelFlow: {j1939: true}}\n"
    dbc, roles_file = unseen_bus.write(
        tmp_path, roles, unseen_bus.DBC.replace("BO_ 385", f"BO_ {0x98FF0AFE}")
    )
    with started(CanDriverNode, domain, dbc_file=str(dbc), roles_file=str(roles_file), **can) as node:
        wait_for(lambda: node.link.state().openings)
        begin_ns = time.monotonic_ns() - 8_000_000_000
        for sent in unseen_bus.frames(begin_ns, begin_ns + 8_000_000_000):
            if ports or len(sent.data) == 4:
                for source in sources:
                    frame = of_group(sent, source)
                    node.receive((frame.arbitration_id, frame.data), frame.stamp_ns)
        (health, *_) = node.health()
        assert health.message.startswith(words)
        assert health.level == level, health.message


def as_29_bits(sent):
    """The frame with the same id in the extended format."""
    return sent._replace(arbitration_id=sent.arbitration_id & 0x7FF)


ABSENT = "frame 'TravelPorts' (0x182) does not come; check the sender and its cable"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda sent, time_s: sent if time_s < 3.0 else None, f"no hydraulics: {ABSENT}"),
        (
            lambda sent, _: sent._replace(data=sent.data[:6]),
            "rejected: wrong length (6 bytes, 8 in the DBC)",
        ),
        (
            lambda sent, _: as_29_bits(sent),
            "with 29 bits of its id 0x182; the DBC has 11; write BO_ 2147",
        ),
    ],
)
def test_frame_that_ceases_or_is_not_that_of_the_dbc_is_named_while_others_come(
    domain, can, tmp_path, change, words
):
    """A pressure sensor that failed in the middle of a drive left the driver running without a word."""
    dbc, roles = unseen_bus.write(tmp_path)
    with started(CanDriverNode, domain, dbc_file=str(dbc), roles_file=str(roles), **can) as node:
        begin_ns = time.monotonic_ns() - 10_000_000_000
        for sent in unseen_bus.frames(begin_ns, begin_ns + 10_000_000_000):
            is_changed = sent.arbitration_id & 0x7FF == 386
            frame = change(sent, (sent.stamp_ns - begin_ns) * 1e-9) if is_changed else sent
            if frame is not None:
                node.receive((frame.arbitration_id, frame.data), frame.stamp_ns)
        (health, *_) = node.health()
        assert health.level == WARN
        assert words in health.message


def test_frame_of_one_side_that_ceases_is_named_as_the_reason_for_no_sprockets(domain, can, tmp_path):
    """Not the roles file is at fault if the cable of the left encoder breaks."""
    left = 'BO_ 384 Left: 2 MC\n SG_ L : 0|16@1- (0.01,0) [0|0] "l/min" ECU\nBO_ 1024'
    roles = unseen_bus.ROLES.replace("TravelFlow.FlowL", "Left.L")
    dbc, roles_file = unseen_bus.write(tmp_path, roles, unseen_bus.DBC.replace("BO_ 1024", left))
    with started(CanDriverNode, domain, dbc_file=str(dbc), roles_file=str(roles_file), **can) as node:
        for sent in unseen_bus.frames(0, 6_000_000_000):
            if len(sent.data) == 4 and sent.stamp_ns < 3_000_000_000:
                node.receive((STANDARD_FLAG | 384, sent.data[:2]), sent.stamp_ns)
            node.receive((sent.arbitration_id, sent.data), sent.stamp_ns)
        message = node.unusable_data_message()
        assert message == "no sprockets: frame 'Left' (0x180) does not come; check the sender and its cable"


def test_frames_that_are_briefly_rejected_are_no_reason_for_an_error(domain, can, tmp_path):
    dbc, roles = unseen_bus.write(tmp_path)
    with started(CanDriverNode, domain, dbc_file=str(dbc), roles_file=str(roles), **can) as node:
        for sent in unseen_bus.frames(0, 3_500_000_000):
            data = sent.data if sent.stamp_ns < 3_000_000_000 else sent.data[:2]
            node.receive((sent.arbitration_id, data), sent.stamp_ns)
        assert node.unusable_data_message() == ""


def test_topic_whose_frames_come_but_never_together_is_named(domain, can, tmp_path):
    dbc, roles = unseen_bus.write(tmp_path)
    files = {"dbc_file": str(dbc), "roles_file": str(roles)}
    with started(CanDriverNode, domain, pairing_timeout=0.01, **files, **can) as node:
        for sent in unseen_bus.frames(0, 8_000_000_000):
            is_late = sent.arbitration_id & 0x7FF == 387
            node.receive((sent.arbitration_id, sent.data), sent.stamp_ns + (25_000_000 if is_late else 0))
        assert "no hydraulics: frames come, but give none" in node.health()[0].message
