# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Drives recorded faster than real time: skipping, streaming and writing by columns lose nothing."""

from pathlib import Path

import numpy as np
import pytest

from trackslip_bags.messages import deserialize, make, serialize
from trackslip_bags.reader import open_bag
from trackslip_common.make import stamp_ns_of
from trackslip_common.topics import TOPICS
from trackslip_sim.machine import offline
from trackslip_sim.machine.excavator import EmulatedExcavator
from trackslip_sim.machine.message_columns import MessageColumns, set_fields, stamp_columns
from trackslip_sim.machine.offline import record_drive
from trackslip_sim.parameters import load_emulator_parameters
from trackslip_sim.scenarios.scenario import load_scenario
from trackslip_sim.truth.record import WINDOW_LENGTH, TruthWindow
from trackslip_sim.truth.settings import load_settings
from trackslip_sim.truth.simulate import duration_of, simulate, simulate_in_pieces

PARAMETERS = load_emulator_parameters(
    {"lead_in": 6.0, "seed": 5, "gnss.device.rate": 10.0, "frame_prefix": "digger1/"}
)
SCENARIO = load_scenario("patches").with_duration(4.0)
MS = 1_000_000


def messages(path: Path) -> list[tuple[str, int, bytes]]:
    with open_bag(path) as bag:
        return [(m.topic, m.log_time_ns, bytes(m.raw)) for m in bag.messages()]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[str, int, bytes]]:
    path = tmp_path_factory.mktemp("offline") / "bag"
    record_drive(PARAMETERS, simulate(SCENARIO), path)
    return messages(path)


def test_skipped_ticks_change_nothing(
    recorded: list[tuple[str, int, bytes]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(EmulatedExcavator, "next_ns", lambda _, sensor, now_ns, tick_ns: now_ns + tick_ns)
    record_drive(PARAMETERS, simulate(SCENARIO), tmp_path / "bag")
    assert messages(tmp_path / "bag") == recorded
    topics = {topic for topic, _, _ in recorded}
    assert topics >= {"/scan", "/box_pose", "/imu/data_raw", "/gnss_pose", "/heading", "/truth/soil"}


def test_frame_of_the_machine_has_its_prefix_on_every_topic(recorded: list[tuple[str, int, bytes]]) -> None:
    frames = {}
    for topic, _, raw in recorded:
        name = topic.removeprefix("/")
        if name != "vehicle":
            message = deserialize(raw, TOPICS[name].type_name)
            frames[name] = getattr(message, "child_frame_id", "") or message.header.frame_id
    of_machine = {name for name, frame in frames.items() if frame == "digger1/base_link"}
    assert of_machine >= {"sprockets", "hydraulics", *(name for name in frames if name.startswith("truth/"))}
    assert "base_link" not in frames.values()


def test_simulation_in_pieces_writes_the_same_bag(
    recorded: list[tuple[str, int, bytes]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("trackslip_sim.truth.simulate.PIECE", 0.7)
    monkeypatch.setattr("trackslip_sim.truth.record.WINDOW_LENGTH", 2.0)
    monkeypatch.setattr(offline, "_WRITE_NS", 1000 * MS)
    window = TruthWindow(simulate_in_pieces(SCENARIO), duration_of(SCENARIO, load_settings()))
    record_drive(PARAMETERS, window, tmp_path / "bag")
    assert messages(tmp_path / "bag") == recorded
    assert window.truth.t[0] > 1.0  # the past is discarded


def test_window_keeps_the_recent_past() -> None:
    pieces = list(simulate_in_pieces(load_scenario("straight").with_duration(130.0), mode="thesis"))
    window = TruthWindow(iter(pieces), 130.0)
    assert not window.advance(59.0)
    assert window.advance(119.0)
    assert window.truth.t[0] <= 119.0 - WINDOW_LENGTH + 60.0
    assert window.truth.t[-1] == pytest.approx(120.0)
    assert window.advance(1000.0)
    assert not window.advance(1000.0)
    assert window.truth.t[-1] == pytest.approx(130.0)
    np.testing.assert_allclose(np.diff(window.truth.t), 0.005, atol=1e-9)


def test_columns_of_every_kind_of_field() -> None:
    """Texts, lists of texts, arrays, sequences, and small numbers before large ones."""
    blank = make(
        "trackslip_msgs/msg/SoilEstimate",
        class_names=["sand", "dry_clay"],
        class_probabilities=[0.25, 0.75],
        reason="none",
    )
    blank.header.frame_id = "map"
    columns = {
        **stamp_columns([1_500_000_000, 7]),
        "mu_r": np.array([0.1, 0.2]),
        "identifiable": np.array([True, False]),
        "class_probabilities": np.array([[0.5, 0.5], [1.0, 0.0]]),
    }
    first, second = (deserialize(raw, blank.__msgtype__) for raw in MessageColumns(blank).serialize(columns))
    assert (stamp_ns_of(first), stamp_ns_of(second)) == (1_500_000_000, 7)
    assert (first.mu_r, second.mu_r, first.identifiable, second.identifiable) == (0.1, 0.2, True, False)
    assert list(second.class_probabilities) == [1.0, 0.0]
    assert (first.reason, first.class_names, first.header.frame_id) == ("none", ["sand", "dry_clay"], "map")
    assert serialize(second)[:8] != serialize(first)[:8]


def test_one_row_of_columns_makes_a_live_message() -> None:
    message = make(TOPICS["truth/odometry"].type_name)
    set_fields(message, {**stamp_columns([3_000_000_001]), "twist.twist.angular.z": np.array([0.5])})
    assert stamp_ns_of(message) == 3_000_000_001
    assert message.twist.twist.angular.z == 0.5
