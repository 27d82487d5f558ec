# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip report``: headline, events, lights, and alignment of runs over several bags."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fixtures.live_messages import diagnostics

from trackslip_bags.input_filters import InputFilters, Thin
from trackslip_bags.messages import make, serialize
from trackslip_bags.reader import open_bag
from trackslip_bags.writer import BagWriter
from trackslip_common.topics import TOPICS
from trackslip_estimation.slip.events import Event as Explaining
from trackslip_estimation.slip.explanations import AcceptedEvent, CompetingExplanations, Explanation
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.motion import Motion
from trackslip_tools.report.details import Details
from trackslip_tools.report.events import Event, LightLog
from trackslip_tools.report.headline import Fact, facts_of
from trackslip_tools.report.lights import SILENT_S, Level
from trackslip_tools.report.panels import motion_panels
from trackslip_tools.report.plots import plot_text
from trackslip_tools.report.recording import Timing, read_recording
from trackslip_tools.report.run import Run, align_runs
from trackslip_tools.report.state_intervals import StateInterval, state_intervals, total_duration
from trackslip_tools.report.timeline import events_of, message_strips, silence_limits, strips
from trackslip_tools.report.verdict import State, load_limits, verdicts

SECOND_NS = 1_000_000_000


def facts(run: Run) -> dict[str, Fact]:
    limits = load_limits()
    return {fact.name: fact for fact in facts_of(run, limits, verdicts(run, limits), events_of(run))}


# Headline


def test_the_headline_agrees_with_the_truth_of_the_drive(emulated_run: Run) -> None:
    truth = emulated_run.replay.paths["reference"].poses[:, :2]
    driven = np.linalg.norm(np.diff(truth, axis=0), axis=1).sum()
    travel = emulated_run.replay.travel
    assert travel.distance == pytest.approx(driven, rel=0.02)
    assert emulated_run.states is not None
    known_s = np.ptp(emulated_run.states.path.stamps_ns) * 1e-9
    assert sum(travel.seconds.values()) == pytest.approx(known_s)
    assert travel.seconds[Motion.TURNING] == pytest.approx(18.0, abs=2.0)  # three legs of 6 s
    facts_by_name = facts(emulated_run)
    assert facts_by_name["Distance"].value == f"{travel.distance:.1f} m"
    assert facts_by_name["Verdict"].state in (State.OK, State.ATTENTION)
    assert facts_by_name["Stalled or stuck"].note == "no hydraulics in the bag"


def test_the_largest_slip_is_one_that_is_known(emulated_run: Run) -> None:
    assert emulated_run.states is not None
    states = emulated_run.states
    k = len(states.rows) // 2

    def largest_slip(steps: int, variance: float | None = None) -> str:
        """With a slip of −300 % over some steps of 10 ms, of this variance."""
        rows, changed = states.rows.copy(), dataclasses.replace(emulated_run)
        rows["slips"][k : k + steps, 0] = -3.0
        if variance is not None:
            rows["slip_covariance"][k : k + steps, 0, 0] = variance
        changed.__dict__["states"] = dataclasses.replace(states, rows=rows)
        return facts(changed)["Largest slip"].value

    assert largest_slip(1) == facts(emulated_run)["Largest slip"].value
    assert largest_slip(200, variance=1.0) == facts(emulated_run)["Largest slip"].value
    assert largest_slip(200) == "-300 %"


def test_a_run_without_an_estimate_has_a_headline_all_the_same(emulated_run: Run) -> None:
    headline = facts(dataclasses.replace(emulated_run, details=Details()))
    assert headline["Distance"].value == "–"
    assert headline["Verdict"].state is State.ATTENTION


# Events


def test_stalled_and_stuck_tracks_are_named_in_headline_verdict_events_and_strip(stalled_run: Run) -> None:
    fact = facts(stalled_run)["Stalled or stuck"]
    assert fact.state is State.ATTENTION
    assert fact.note == "stalled: left track 10.0 s; getting stuck: right track 5.0 s"
    verdict = verdicts(stalled_run, load_limits())["Tracks"]
    assert (verdict.state, verdict.value) == (State.ATTENTION, fact.note)
    reported = [(round(1e-3 * event.time_ms), event.text) for event in events_of(stalled_run)]
    assert (10, "left track stalled for 10.0 s") in reported
    assert (30, "right track getting stuck for 5.0 s") in reported
    (strip,) = strips([stalled_run])
    (left,), (right,) = strip.rows["left track"], strip.rows["right track"]
    assert (left.style.label, right.style.label) == ("stalled", "getting stuck")
    assert (left.interval.start, left.interval.stop) == pytest.approx((10.0, 20.0))


def test_lost_fixes_and_gated_fixes_are_events(emulated_run: Run) -> None:
    assert events_of(emulated_run) == []
    details, at_s = Details(), emulated_run.recording.seconds(emulated_run.details.fixes["stamp_ns"])
    details.sources = emulated_run.details.sources
    fixes, reports = emulated_run.details.fixes.copy(), emulated_run.details.reports.copy()
    lost = (at_s > 20.0) & (at_s < 26.0)
    fixes["outcome"][lost] = Outcome.GATED
    details._fixes.add(fixes)
    reports_s = emulated_run.recording.seconds(reports["stamp_ns"])
    of_fixes = reports["source"] == fixes["source"][0]
    reports["outcome"][of_fixes & (reports_s > 20.0) & (reports_s < 26.0)] = Outcome.GATED
    details._reports.add(reports)
    changed = dataclasses.replace(emulated_run, details=details)
    reported = [event.text for event in events_of(changed)]
    assert len(reported) == 2
    (strip,) = strips([changed])
    ((start, stop, *_), _) = strip.rows["box_pose"][0]
    assert (start, stop) == pytest.approx((20.0, 26.0), abs=0.5)
    words = f"for {stop - start:.1f} s, from {start:.1f} to {stop:.1f} s"
    assert f"fix lost: nothing accepted of box_pose {words}" in reported
    assert any(text.startswith(f"gate rejects {lost.sum()} of box_pose within") for text in reported)


def test_fixes_are_not_lost_after_the_last_measurement(emulated_run: Run) -> None:
    """A recorder continues for some seconds after all nodes have ended."""
    recording = dataclasses.replace(emulated_run.recording, stop_s=emulated_run.recording.stop_s + 20.0)
    assert events_of(dataclasses.replace(emulated_run, recording=recording)) == []


def test_a_silent_gyro_is_an_event(emulated_run: Run) -> None:
    times = emulated_run.recording.timings["imu/data_raw"].times
    limit = silence_limits(emulated_run)["imu/data_raw"]
    silent = Timing(times[(times < 10.0) | (times > 11.0 + limit)])
    timings = {**emulated_run.recording.timings, "imu/data_raw": silent}
    recording = dataclasses.replace(emulated_run.recording, timings=timings)
    (event,) = events_of(dataclasses.replace(emulated_run, recording=recording))
    assert event.text == f"imu/data_raw silent for {limit + 1.1:.1f} s"


def test_fixes_at_1_hz_are_not_lost_between_two_of_them(
    emulated_bag: Path, run_over: Callable[..., Run]
) -> None:
    """The timeout is 1 s; about half of the stamp intervals at 1 Hz are longer."""
    run = run_over(emulated_bag, filters=InputFilters(thin=(Thin("box_pose", 1.0),)))
    stamps_ns = np.sort(run.details.fixes["stamp_ns"])
    assert (np.diff(stamps_ns) > run.parameters.timeouts_ns()["box_pose"]).any()
    assert [event.text for event in events_of(run) if "fix lost" in event.text] == []
    assert verdicts(run, load_limits())["Gaps"].state is State.OK


def test_competing_explanations_and_accepted_events_are_reported(emulated_run: Run) -> None:
    """A replay provides both; the bag may lack /diagnostics."""
    zero_ns = emulated_run.recording.zero_ns
    off = Explanation("box_pose is 1.0 m off", 0.9, zero_ns)
    moved = Explanation("the machine was moved", 0.1, zero_ns, is_ongoing=False)
    details = Details()
    details.sources = emulated_run.details.sources
    for at_s in range(10, 31):
        explanations = [off, moved] if at_s < 20 else [off._replace(probability=1.0)] if at_s < 24 else []
        details.add_explanations([CompetingExplanations(zero_ns + at_s * SECOND_NS, explanations)])
    events = [
        AcceptedEvent(zero_ns + 10 * SECOND_NS, Explaining.OFFSET, "box_pose", 1.0),
        AcceptedEvent(zero_ns + 15 * SECOND_NS, Explaining.OUTLIER, "box_pose", 1.0),
        AcceptedEvent(zero_ns + 24 * SECOND_NS, Explaining.RECOVERED, "box_pose", 1.0),
    ]
    replayed = dataclasses.replace(emulated_run.replay, accepted_events=events)
    run = dataclasses.replace(emulated_run, details=details, replay=replayed)
    reported = [(event.level, 1e-3 * event.time_ms, event.text) for event in events_of(run)]
    both = "two explanations for 10.0 s: box_pose is 1.0 m off (90 %), the machine was moved (10 %)"
    assert (Level.WARN, pytest.approx(10.0), both) in reported
    assert (Level.WARN, pytest.approx(10.0), "box_pose is off") in reported
    assert (Level.OK, pytest.approx(24.0), "box_pose has recovered") in reported
    assert not any("outlier" in text for *_, text in reported)
    (strip,) = (strip for strip in strips([run]) if "explanations" in strip.rows)
    (competing, one) = strip.rows["explanations"]
    assert (competing.style.label, competing.interval.text) == ("explanations compete", both)
    assert (one.style.label, one.interval.text) == ("explained", "box_pose is 1.0 m off")
    assert (one.interval.start, one.interval.stop) == pytest.approx((20.0, 24.0))


# Lights


def test_state_intervals_are_contiguous_up_to_a_gap_or_the_end() -> None:
    intervals = state_intervals(np.array((0.0, 1.0, 2.0, 3.0, 8.0, 9.0)), np.array((1, 1, 2, 1, 1, 1)))
    ends = [(interval.start, interval.stop, interval.state) for interval in intervals]
    assert ends == [(0.0, 2.0, 1), (2.0, 3.0, 2), (3.0, 3.0, 1), (8.0, 9.0, 1)]
    assert total_duration(intervals, 1) == 3.0
    assert state_intervals(np.empty(0), np.empty(0)) == []


def test_recorded_lights_show_failure_silence_and_recovery_of_a_node() -> None:
    log = LightLog()
    for second in range(40):
        log.add(diagnostics("can_driver"), second + 0.5)
        if not 20 <= second < 30:
            level, text = (2, "not connected") if second < 10 else (0, f"{second} frames")
            log.add(diagnostics("sick_pls", level, text), float(second) + 0.6)
    intervals = log.intervals(40.0)
    levels = [(interval.state, round(interval.start, 1)) for interval in intervals["sick_pls"]]
    assert [level for level, _ in levels] == [Level.ERROR, Level.OK, Level.SILENT, Level.OK]
    assert levels[2][1] == pytest.approx(19.6 + SILENT_S, abs=1.0)
    assert [interval.state for interval in intervals["can_driver"]] == [Level.OK]
    assert intervals["can_driver"][0].stop == 40.0
    assert log.events[0].text == "sick_pls: not connected"


def test_lights_are_silent_after_the_last_message() -> None:
    log = LightLog()
    log.add(diagnostics("can_driver"), 1.0)
    assert [interval.state for interval in log.intervals(9.0)["can_driver"]] == [Level.OK, Level.SILENT]


def test_a_bag_with_diagnostics_shows_its_lights(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        for second in range(5):
            log_ns = SECOND_NS * (100 + second)
            message = serialize(diagnostics("digger1/sick_pls", 1, "<b>cold</b>"))
            bag.write("/diagnostics", TOPICS["diagnostics"].type_name, message, log_ns)
            text = serialize(make("std_msgs/msg/String", data="no lights"))
            bag.write("/elsewhere/diagnostics", "std_msgs/msg/String", text, log_ns)
    with open_bag(tmp_path / "bag") as opened:
        recording = read_recording(opened, InputFilters(), "digger1")
    (interval,) = recording.lights["sick_pls"]
    assert (interval.state, interval.text) == (Level.WARN, "<b>cold</b>")
    assert recording.events == [Event(1, 0.0, Level.WARN, "sick_pls: <b>cold</b>")]


def test_the_strip_shows_where_messages_are_missing(emulated_run: Run) -> None:
    (strip,) = message_strips([emulated_run])
    assert list(strip.rows) == list(emulated_run.recording.timings)
    assert {bar.style.label for bar in strip.rows["sprockets"]} == {"messages"}


# Several bags


def test_runs_over_two_bags_are_aligned_at_the_start_of_driving(emulated_run: Run) -> None:
    lit = dataclasses.replace(emulated_run.recording, lights={"a": [StateInterval(4.0, 6.0, 0)]})
    later = dataclasses.replace(lit, path="later", start_ns=lit.start_ns - 5 * SECOND_NS)
    later = dataclasses.replace(later, zero_ns=later.start_ns)
    first, second = align_runs([emulated_run, dataclasses.replace(emulated_run, recording=later)])
    for run in (first, second):
        speed = next(panel for panel in motion_panels([run]) if panel.title == "Speed")
        moving = speed.curves[1].times[speed.curves[1].values > 0.1]
        assert 0.0 <= moving[0] < 1.0
    assert first.recording.zero_ns == second.recording.zero_ns
    assert second.recording.lights["a"][0].start == pytest.approx(
        4.0 - (first.recording.zero_ns - later.start_ns) * 1e-9
    )
    assert second.recording.start_ns == later.start_ns


def test_runs_over_one_bag_keep_its_times(emulated_run: Run) -> None:
    assert align_runs([emulated_run, emulated_run]) == [emulated_run, emulated_run]


# Texts


@pytest.mark.parametrize("text", ["$$x$$", "\\(x\\)", "\\[x\\]"])
def test_text_in_a_plot_is_never_rendered_as_mathematics(text: str) -> None:
    shown = plot_text(text)
    assert not any(opening in shown for opening in ("$$", "\\(", "\\["))
    assert shown.replace("\u200b", "") == text


def test_a_long_name_is_cut_in_its_middle() -> None:
    assert plot_text("a" * 30 + "b" * 30, 21) == "a" * 10 + "…" + "b" * 10
