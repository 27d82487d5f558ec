# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The emulator node: when it starts the machine, and the frames of its truth and its sensors."""

from pathlib import Path
from typing import Any

import pytest
from fixtures.own_node import started
from std_msgs.msg import String

from trackslip_sim.nodes.emulator import EmulatorNode

pytestmark = pytest.mark.xdist_group("graph")
TRUTH = ("odometry", "track_slip", "track_forces", "attitude", "soil")
SENSED = ("sprockets", "hydraulics")


def test_machine_is_switched_on_once_all_nodes_that_it_waits_for_are_active(
    programs: Any, observer: Any, can: dict[str, Any]
) -> None:
    space = ("-r", "__ns:=/digger1")
    healths = observer.healths()
    truth = {name: observer.subscribe(f"/digger1/truth/{name}", f"truth/{name}") for name in TRUTH}
    sensed = {name: observer.subscribe(f"/digger1/{name}", name) for name in SENSED}
    programs.node(
        "emulator",
        *space,
        start_after=["gnss_localizer", "can_driver"],
        frame_prefix="digger1/",
        device_directory=str(programs.folder / "dev"),
        scenario="straight",
        mode="thesis",
        lead_in=0.0,
        can_delay=0.0,
        **can,
    )

    def waits_for(names: str) -> bool:
        return any(
            h.name == "digger1/emulator" and f"waiting for {names} to be" in h.message for h in healths
        )

    observer.wait(lambda: waits_for("gnss_localizer, can_driver"), "the emulator to wait for both")
    programs.node("can_driver", *space, frame_prefix="digger1/", **can)
    programs.node("gnss_localizer", *space, autostart=False)
    observer.wait(lambda: waits_for("gnss_localizer"), "the emulator to wait for the other one")
    assert observer.change("/digger1/gnss_localizer", "configure")
    assert {name: len(messages) for name, messages in truth.items()} == dict.fromkeys(TRUTH, 0)
    assert observer.change("/digger1/gnss_localizer", "activate")
    received = truth | sensed
    observer.wait(lambda: all(received.values()), "truth and sensors")
    frames = {name: messages[0].header.frame_id for name, messages in received.items()}
    assert frames == {**dict.fromkeys(received, "digger1/base_link"), "odometry": "map"}
    assert truth["odometry"][0].child_frame_id == "digger1/base_link"


@pytest.mark.slow
def test_machine_that_waits_can_be_deactivated_and_activated_again(programs: Any, observer: Any) -> None:
    programs.node(
        "emulator", start_after=["nobody"], device_directory=str(programs.folder / "dev"), scenario="straight"
    )
    observer.wait_until_active("/emulator")
    for transition in ("deactivate", "activate", "deactivate", "cleanup", "configure"):
        assert observer.change("/emulator", transition), transition


def test_fault_of_one_drive_is_not_applied_to_the_next(
    domain: int, can: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(EmulatorNode, "_run_devices", lambda *_: None)  # takes no fault from the queue
    drive = {"device_directory": str(tmp_path / "dev"), "scenario": "straight", "mode": "thesis"}
    with started(EmulatorNode, domain, **drive, **can) as node:
        node._on_fault(String(data="{sensor: sick, kind: unplug, duration: 5}"))
        assert not node._requested_faults.empty()
        node.trigger_deactivate()
        node.trigger_activate()
        assert node._requested_faults.empty()
