# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The live page's buffer: frames agree with the whole, have only JSON values, and memory is bounded."""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from fixtures import live_messages as messages
from hypothesis import example, given
from hypothesis import strategies as st

from trackslip_bags.messages import make
from trackslip_common.config_files import parameters_text
from trackslip_common.vehicle_files import load_vehicle, vehicle_text
from trackslip_tools.live import strips
from trackslip_tools.live.state import MOST_POINTS, PERIOD, LiveState, Trail
from trackslip_tools.live.strips import LINES, PANELS, Strips

LEFT_SLIP = next(k for k, line in enumerate(LINES) if PANELS[line.panel].title == "Slip of the left track")
PERCENT = PANELS[LINES[LEFT_SLIP].panel].scale


def as_json(frame: dict[str, Any]) -> Any:
    return json.loads(json.dumps(frame, allow_nan=False))


@pytest.fixture
def state() -> LiveState:
    return LiveState("a test", load_vehicle())


def drive(state: LiveState, ticks: int, speed: float = 0.4) -> list[Any]:
    frames = []
    for k in range(ticks):
        now_s = PERIOD * k
        state.process("odometry", messages.odometry(speed * now_s, 0.0), now_s)
        state.process("track_slip", messages.track_slip(0.2, -0.02), now_s)
        frames.append(as_json(state.next_frame(now_s, 1000.0 * now_s)))
    return frames


def test_a_frame_has_the_newest_point_of_each_curve(state: LiveState) -> None:
    *_, frame = drive(state, 3)
    value, low, high = frame["row"][LEFT_SLIP]
    assert value == pytest.approx(0.2 * PERCENT)
    assert high - value == pytest.approx(0.02 * PERCENT)  # 2σ
    assert value - low == pytest.approx(0.02 * PERCENT)
    assert len(frame["row"]) == len(LINES)
    assert frame["facts"]["motion"] == "straight"


def test_heading_with_a_large_deviation_is_shown_as_unknown(state: LiveState) -> None:
    for stddev, shown in ((0.1, "0.0° ± 11.5"), (19.2, "unknown")):
        state.process("odometry", messages.odometry(0.0, 0.0, variance=stddev**2), 0.0)
        assert state.next_frame(0.0, 0.0)["facts"]["heading"] == shown


def test_the_whole_is_the_sum_of_the_frames(state: LiveState) -> None:
    assert state.full_state() == {}
    frames = drive(state, 40)
    whole = as_json(state.full_state())
    assert whole["number"] == frames[-1]["number"]
    assert whole["rows"] == [frame["row"] for frame in frames]
    assert whole["trail"] == [frame["path"] for frame in frames if "path" in frame]
    assert whole["row"] == frames[-1]["row"]


def test_slips_are_not_shown_at_standstill(state: LiveState) -> None:
    state.process("odometry", messages.odometry(0.0, 0.0), 0.0)
    state.process("track_slip", messages.track_slip(0.5, 0.5, motion_state=1), 0.0)
    frame = as_json(state.next_frame(0.0, 0.0))
    assert frame["row"][LEFT_SLIP] == [None, None, None]
    assert frame["facts"]["motion"] == "standing"


def test_outdated_values_are_shown_at_the_end_of_the_input_alone(state: LiveState) -> None:
    *_, last = drive(state, 2)
    outdated = state.next_frame(60.0, 60e3)
    assert (outdated["facts"]["position"], outdated["outlines"]["machine"]) == ("–", ([], []))
    before = as_json(state.full_state())
    for number in range(before["number"] + 1, before["number"] + 4):
        frame = as_json(state.final_frame("end of the bag"))
        assert (frame["number"], frame["time"], frame["ended"]) == (number, 60_000, "end of the bag")
        for name in ("facts", "row", "outlines"):
            assert frame[name] == last[name]
        assert frame["events"] == []
    after = as_json(state.full_state())
    assert after["ended"] == "end of the bag"
    for name in ("times", "rows", "trail", "events"):
        assert after[name] == before[name]


def test_vehicle_of_the_message_is_drawn(state: LiveState) -> None:
    small = as_json(drive(state, 1)[-1])["outlines"]["machine"]
    text = vehicle_text(load_vehicle("excavator_20t"))
    state.process("vehicle", make("std_msgs/msg/String", data=text), 0.0)
    frame = drive(state, 1)[-1]
    assert frame["facts"]["vehicle"] == "excavator_20t"
    assert np.ptp(frame["outlines"]["machine"][0]) > 2.0 * np.ptp(small[0])


def test_malformed_vehicle_is_an_event(state: LiveState) -> None:
    state.process("vehicle", make("std_msgs/msg/String", data="}{"), 0.0)
    assert "vehicle" in drive(state, 1)[-1]["events"][0][-1]


def test_soil_and_fixes_are_shown(state: LiveState) -> None:
    state.process("soil", messages.soil(sand=0.7, clay=0.2, loam=0.06, peat=0.04), 0.0)
    state.process("box_pose", messages.fix(1.0, 2.0), 0.0)
    frame = as_json(state.next_frame(0.0, 0.0))
    assert frame["classes"] == [["sand", 0.7, True], ["clay", 0.2, False], ["loam", 0.06, False]]
    assert frame["new_fixes"] == [[1.0, 2.0]]
    assert len(frame["outlines"]["box"][0]) == 5
    assert "new_fixes" not in state.next_frame(0.1, 0.1)


def test_soil_that_is_not_identifiable_is_not_named_as_found(state: LiveState) -> None:
    state.process("soil", messages.soil(False, sand=0.9, clay=0.1), 0.0)
    frame = as_json(state.next_frame(0.0, 0.0))
    assert frame["classes"] == [["sand", 0.9, False], ["clay", 0.1, False]]
    assert frame["events"] == []


def parameters(**timeouts: float) -> Any:
    """Parameters message of the slip estimator with the timeouts of these pose sources."""
    groups = {name: {"timeout": timeout} for name, timeout in timeouts.items()}
    stated = {"pose_sources": list(timeouts), "sources": groups}
    return make("std_msgs/msg/String", data=parameters_text(stated, "slip_estimator"))


@pytest.mark.parametrize("source", ["reference_pose", "rtk"])
def test_fixes_of_any_source_are_drawn(state: LiveState, source: str) -> None:
    state.process("slip_estimator/parameters", parameters(rtk=2.0), 0.0)
    assert source in state.pose_sources
    state.process(source, messages.fix(3.0, 4.0), 0.0)
    assert as_json(state.next_frame(0.0, 0.0))["new_fixes"] == [[3.0, 4.0]]


@pytest.mark.parametrize(
    ("timeout", "fixes_s", "frames_s", "expected"),
    [
        (2.0, (-0.5, 0.0, 12.0), (-0.5, 0.0, 1.9, 2.1, 9.0, 12.0), [(2.1, "lost"), (12.0, "back")]),
        (1.0, (0.0, 1.05, 2.1, 3.15, 4.2), (0.0, 1.04, 2.09, 3.14, 4.19, 5.2, 7.2, 7.4), [(7.4, "lost")]),
    ],
    ids=["timeout", "three periods of a slower source"],
)
def test_silent_source_is_reported_as_lost_and_then_as_back(
    state: LiveState,
    timeout: float,
    fixes_s: Sequence[float],
    frames_s: Sequence[float],
    expected: list[tuple[float, str]],
) -> None:
    state.process("slip_estimator/parameters", parameters(rtk=timeout), 0.0)
    reported = []
    for now_s, is_frame in sorted([*((t, False) for t in fixes_s), *((t, True) for t in frames_s)]):
        if is_frame:
            reported += [(now_s, text) for *_, text in state.next_frame(now_s, 1e3 * now_s)["events"]]
        else:
            state.process("rtk", messages.fix(0.0, 0.0), now_s)
    assert reported == [(now_s, f"fix {change}: rtk") for now_s, change in expected]


def test_lost_fix_is_not_reported_beside_diagnostics_of_the_estimator(state: LiveState) -> None:
    state.process("slip_estimator/parameters", parameters(rtk=2.0), 0.0)
    state.process("rtk", messages.fix(0.0, 0.0), 0.0)
    state.process("diagnostics", messages.diagnostics("slip_estimator"), 3.0)
    assert state.next_frame(3.0, 0.0)["events"] == []


@pytest.mark.parametrize(
    "text", ["}{", "[]", "slip_estimator: 1", "slip_estimator: {ros__parameters: {pose_sources: 1}}"]
)
def test_malformed_parameters_have_no_effect(state: LiveState, text: str) -> None:
    known = state.pose_sources
    state.process("slip_estimator/parameters", make("std_msgs/msg/String", data=text), 0.0)
    assert state.pose_sources == known
    as_json(state.next_frame(0.0, 0.0))


def test_a_message_of_another_type_is_refused(state: LiveState) -> None:
    with pytest.raises(AttributeError):
        state.process("odometry", messages.soil(), 0.0)


@given(
    values=st.lists(st.floats(allow_nan=True, allow_infinity=True, width=64), min_size=8, max_size=8),
    text=st.text(),
)
@example(values=[0.0, 1e307, *[0.0] * 6], text="")  # overflows when rounded
def test_whatever_numbers_and_texts_come_frames_are_json(values: list[float], text: str) -> None:
    state = LiveState(text, load_vehicle())
    odometry = messages.odometry(values[0], values[1], values[2], values[3])
    odometry.pose.pose.orientation.z = values[4]
    state.process("odometry", odometry, 0.0)
    state.process("track_slip", messages.track_slip(values[5], values[6]), 0.0)
    state.process("soil", messages.soil(**{text: values[7]}), 0.0)
    state.process("box_pose", messages.fix(values[0], values[5]), 0.0)
    attitude = make("sensor_msgs/msg/Imu", orientation_covariance=np.full(9, values[3]))
    attitude.orientation.x = values[6]
    state.process("attitude", attitude, 0.0)
    swing = make("sensor_msgs/msg/JointState", name=["swing"], position=[values[7]])
    state.process("swing", swing, 0.0)
    state.process("diagnostics", messages.diagnostics(text, 2, text, **{"rate (Hz)": str(values[2])}), 0.0)
    for topic in ("vehicle", "slip_estimator/parameters"):
        state.process(topic, make("std_msgs/msg/String", data=text), 0.0)
    as_json(state.next_frame(0.0, 0.0))
    as_json(state.full_state())


@pytest.mark.slow
def test_memory_of_the_state_is_bounded(state: LiveState) -> None:
    ticks = strips.ROWS + 50
    drive(state, ticks, speed=40.0)
    early = len(json.dumps(state.full_state()))
    drive(state, 2 * ticks, speed=40.0)
    assert len(json.dumps(state.full_state())) < 1.1 * early


@pytest.mark.parametrize("most", [10, MOST_POINTS])
def test_a_path_keeps_its_shape_when_points_are_dropped(most: int) -> None:
    trail = Trail(most, 0.1)
    for k in range(20 * most):
        trail.add(0.1 * k, 0.0)
    assert most // 2 <= len(trail.points) <= most
    assert trail.thinning_count > 0
    gaps = np.diff([x for x, _ in trail.points])
    assert gaps.max() < 2.5 * gaps.min()
    assert trail.points[0] == (0.0, 0.0)


def test_strips_have_the_panels_of_the_report() -> None:
    history = Strips(5)
    for k in range(8):
        history.add(float(k), {})
    times, values = history.stored_rows()
    assert times.tolist() == [3.0, 4.0, 5.0, 6.0, 7.0]
    assert np.isnan(values).all()
    assert [panel.title for panel in history.panels()] == [panel.title for panel in PANELS]
    assert sum(len(panel.curves) for panel in history.panels()) == len(LINES)
