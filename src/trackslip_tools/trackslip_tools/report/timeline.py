# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Events of a run: motion, tracks in trouble, lost fixes, gate rejections, soils, diagnostics."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby

import numpy as np

from trackslip_common.errors import printable
from trackslip_common.topics import SOIL
from trackslip_estimation.slip.events import Event as Explaining
from trackslip_estimation.slip.explanations import CompetingExplanations, sentence
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.slip.silence import silence_limit, usual_period
from trackslip_estimation.soil.stall import TrackCondition
from trackslip_tools.replay import stuck_tracks
from trackslip_tools.replay.inputs import SPROCKETS
from trackslip_tools.replay.stuck_tracks import TROUBLE_TEXTS
from trackslip_tools.report.events import Event, Events, mask_numbers
from trackslip_tools.report.lights import Level
from trackslip_tools.report.panel import AMBER, BLUE, GREEN, GREY, GRID, ORANGE, PURPLE, SKY
from trackslip_tools.report.recording import Timing
from trackslip_tools.report.run import Run, first_runs_of_bags
from trackslip_tools.report.run_styles import plot_title
from trackslip_tools.report.state_intervals import (
    Bar,
    StateInterval,
    Strip,
    Style,
    bars,
    state_intervals,
    total_duration,
)

_MESSAGES_STYLE, _GAP_STYLE = Style(BLUE, "messages"), Style(ORANGE, "missing")
_GROUP_GAP_S = 5.0  # s without a rejection that separate groups of rejections
_MAX_REJECTED_SHARE = 0.1  # share of a source's measurements; a larger rejected share is a warning
_START_S, _END_S = 10.0, 3.0  # s at the ends of a recording in which nodes start and stop
_FIRST_S = 5.0  # s after the first measurement in which nodes still start
_LIGHT_STYLES = {
    int(Level.OK): Style(GREEN, "ok"),
    int(Level.WARN): Style(AMBER, "warning"),
    int(Level.ERROR): Style(ORANGE, "error"),
    int(Level.STALE): Style(PURPLE, "no data"),
    int(Level.SILENT): Style(GREY, "silent"),
}
_MOTION_STYLES = {
    int(Motion.UNKNOWN): Style(GRID, "unknown"),
    int(Motion.STANDING): Style(GREY, "standing"),
    int(Motion.STRAIGHT): Style(SKY, "straight"),
    int(Motion.TURNING): Style(BLUE, "turning"),
}
_STUCK_TRACK_STYLES = {
    int(TrackCondition.STALLED): Style(ORANGE, TROUBLE_TEXTS[TrackCondition.STALLED]),
    int(TrackCondition.STUCK): Style(AMBER, TROUBLE_TEXTS[TrackCondition.STUCK]),
}
_NO_EXPLANATION, _ONE_EXPLANATION, _SEVERAL_EXPLANATIONS = 0, 1, 2
_EXPLANATION_STYLES = {
    _ONE_EXPLANATION: Style(GREEN, "explained"),
    _SEVERAL_EXPLANATIONS: Style(AMBER, "explanations compete"),
}
_LOST_STATE = 0
_LOST_STYLES = {_LOST_STATE: Style(PURPLE, "nothing accepted")}


def motion_intervals(run: Run) -> list[StateInterval]:
    """Intervals of standstill, straight and turning motion: states of ``Motion``."""
    if run.states is None:
        return []
    rows = run.states.rows
    return state_intervals(run.recording.seconds(rows["stamp_ns"]), rows["motion"])


def stuck_track_intervals(run: Run) -> dict[str, list[StateInterval]]:
    """Side → intervals in which its track was in trouble: states of ``TrackCondition``."""
    soil = run.replay.soil
    if soil is None:
        return {}
    return stuck_tracks.stuck_track_intervals(run.recording.seconds(soil.forces["stamp_ns"]), soil.forces)


def loss_intervals(run: Run) -> dict[str, list[StateInterval]]:
    """Source of poses → intervals without an accepted fix, longer than its silence limit."""
    fixes, limits = run.details.accepted_fixes, silence_limits(run)
    intervals: dict[str, list[StateInterval]] = {}
    for number, source in enumerate(run.details.sources):
        times = np.sort(run.recording.seconds(fixes["stamp_ns"][fixes["source"] == number]))
        if source in limits and len(times):
            ends = np.append(times[1:], max(measured_interval(run).stop, times[-1]))
            gaps = np.flatnonzero(ends - times > limits[source])
            intervals[source] = [StateInterval(float(times[k]), float(ends[k]), _LOST_STATE) for k in gaps]
    return {source: own for source, own in intervals.items() if own}


def measured_interval(run: Run) -> StateInterval:
    """From the first to the last measurement of any source; a recording starts and stops outside of it."""
    timings = (run.recording.timings.get(name) for name in silence_limits(run))
    spans = [(timing.times[0], timing.times[-1]) for timing in timings if timing and len(timing.times)]
    if not spans:
        return StateInterval(run.recording.start_s, run.recording.stop_s, 0)
    return StateInterval(float(min(first for first, _ in spans)), float(max(last for _, last in spans)), 0)


def explanation_intervals(run: Run) -> list[StateInterval]:
    """Intervals with one explanation or several competing ones, with their texts."""
    groups = [list(group) for _, group in groupby(run.details.explanations, _explanation_state)]
    ends_ns = [group[0].stamp_ns for group in groups[1:]] + [group[-1].stamp_ns for group in groups[-1:]]
    return [
        _explanation_interval(run, group, end_ns)
        for group, end_ns in zip(groups, ends_ns, strict=True)
        if group[0].number_competing
    ]


def _explanation_state(competing: CompetingExplanations) -> tuple[int, str]:
    """State and text that distinguish one interval from the next, without numbers in the text."""
    if competing.number_competing == 1:
        return _ONE_EXPLANATION, mask_numbers(competing.explanations[0].text)
    return (_SEVERAL_EXPLANATIONS if competing.number_competing else _NO_EXPLANATION), ""


def _explanation_interval(run: Run, group: Sequence[CompetingExplanations], end_ns: int) -> StateInterval:
    """Interval of a group that competes; its text is that of the group's middle."""
    start, stop = run.recording.seconds(np.array((group[0].stamp_ns, end_ns))).tolist()
    explanations = group[len(group) // 2].explanations
    text = sentence(explanations, stop - start) if len(explanations) > 1 else explanations[0].text
    return StateInterval(start, stop, _explanation_state(group[0])[0], text)


def stuck_tracks_text(intervals: Mapping[str, Sequence[StateInterval]]) -> str:
    """Trouble, track and total duration of each; empty without troubles."""
    reported = [
        f"{TROUBLE_TEXTS[trouble]}: {side} track {seconds:.1f} s"
        for trouble in (TrackCondition.STALLED, TrackCondition.STUCK)
        for side, of_side in intervals.items()
        if (seconds := total_duration(of_side, trouble)) > 0.0
    ]
    return "; ".join(reported)


def silence_limits(run: Run) -> dict[str, float]:
    """Source of the slip estimator → s without a message after which it is lost, as in ``silence``."""
    timeouts = {name: timeout_ns * 1e-9 for name, timeout_ns in run.parameters.timeouts_ns().items()}
    periods = {name: timing.period for name, timing in run.recording.timings.items()}
    fixes, sources = run.details.fixes, run.details.sources
    for number in np.unique(fixes["source"]).tolist():  # periods after thinning of the bag
        stamps_ns = fixes["stamp_ns"][fixes["source"] == number]
        periods[sources[number]] = usual_period(run.recording.seconds(stamps_ns))
    limits = {name: silence_limit(timeout, periods.get(name, np.nan)) for name, timeout in timeouts.items()}
    return limits | {SPROCKETS: run.parameters.sprocket_timeout}  # longer silence: motion unknown


def strips(runs: Sequence[Run]) -> list[Strip]:
    """Strips of each run with motion, troubles and lost fixes; strips of each bag with its diagnostics."""
    strips_of_runs = []
    for run in runs:
        rows = {"motion": bars(motion_intervals(run), _MOTION_STYLES)}
        for side, intervals in stuck_track_intervals(run).items():
            rows[f"{side} track"] = bars(intervals, _STUCK_TRACK_STYLES)
        rows |= {source: bars(intervals, _LOST_STYLES) for source, intervals in loss_intervals(run).items()}
        explanations = explanation_intervals(run)
        if explanations:
            rows["explanations"] = bars(explanations, _EXPLANATION_STYLES)
        if any(rows.values()):
            strips_of_runs.append(Strip(plot_title(runs, run, "Motion, tracks in trouble, lost fixes"), rows))
    for run in first_runs_of_bags(runs):
        rows = {name: bars(intervals, _LIGHT_STYLES) for name, intervals in run.recording.lights.items()}
        if rows:
            strips_of_runs.append(Strip(plot_title(runs, run, "Lights of sensors and nodes"), rows))
    return strips_of_runs


def message_strips(runs: Sequence[Run]) -> list[Strip]:
    """Strip of each bag with the times of messages and gaps, by topic."""
    strips_of_bags = []
    for run in first_runs_of_bags(runs):
        timings = {name: timing for name, timing in run.recording.timings.items() if len(timing.times)}
        rows = {name: _message_bars(timing) for name, timing in timings.items()}
        strips_of_bags.append(Strip(plot_title(runs, run, "Messages"), rows))
    return strips_of_bags


def _message_bars(timing: Timing) -> list[Bar]:
    gaps = timing.gaps
    edges = [float(timing.times[0]), *(edge for gap in gaps for edge in gap), float(timing.times[-1])]
    messages = [
        Bar(StateInterval(a, b, 0), _MESSAGES_STYLE) for a, b in zip(edges[::2], edges[1::2], strict=True)
    ]
    return messages + [Bar(StateInterval(gap.start, gap.stop, 0), _GAP_STYLE) for gap in gaps]


def events_of(run: Run) -> list[Event]:
    """All events by time (ms); ``number`` is unused."""
    events = (
        *_stuck_track_events(run),
        *_lost_fix_events(run),
        *_silence_events(run),
        *_rejection_events(run),
        *_explanation_events(run),
        *_soil_events(run),
        *_fold_start_and_stop(run),
    )
    return sorted(events, key=lambda event: event.time_ms)


def _fold_start_and_stop(run: Run) -> list[Event]:
    """Events of diagnostics; those of starting or stopping nodes are combined into one line each."""
    measured = measured_interval(run)
    first = 1e3 * max(_START_S, measured.start + _FIRST_S)
    last = 1e3 * min(run.recording.stop_s - _END_S, measured.stop)
    begin = [event for event in run.recording.events if event.time_ms < first]
    end = [event for event in run.recording.events if event.time_ms > max(last, first)]
    between = [event for event in run.recording.events if event not in (*begin, *end)]
    folded = []
    for group, word in ((begin, "start-up"), (end, "shut-down")):
        if len(group) > 1:
            group = [group[0]._replace(level=Level.OK, text=f"{word}: {len(group)} reports of nodes")]
        folded += group
    return [*folded, *between]


def _make_event(at_s: float, level: Level, text: str) -> Event:
    return Event(0, 1e3 * at_s, level, printable(text))


def _stuck_track_events(run: Run) -> Iterator[Event]:
    for side, intervals in stuck_track_intervals(run).items():
        for interval in intervals:
            duration = f"for {interval.stop - interval.start:.1f} s"
            text = f"{side} track {TROUBLE_TEXTS[TrackCondition(interval.state)]} {duration}"
            yield _make_event(interval.start, Level.WARN, text)


def _lost_fix_events(run: Run) -> Iterator[Event]:
    for source, intervals in loss_intervals(run).items():
        for start, stop, *_ in intervals:
            duration = f"for {stop - start:.1f} s, from {start:.1f} to {stop:.1f} s"
            yield _make_event(start, Level.WARN, f"fix lost: nothing accepted of {source} {duration}")


def _silence_events(run: Run) -> Iterator[Event]:
    """Silences of sources other than fixes, longer than their limits."""
    fixes = {run.details.sources[number] for number in np.unique(run.details.fixes["source"])}
    for source, limit in silence_limits(run).items():
        timing = run.recording.timings.get(source)
        for gap in timing.gaps if timing is not None and source not in fixes else ():
            if gap.stop - gap.start > limit:
                yield _make_event(gap.start, Level.WARN, f"{source} silent for {gap.stop - gap.start:.1f} s")


def _rejection_events(run: Run) -> Iterator[Event]:
    """Gate rejections, combined into groups."""
    reports = run.details.reports
    gated = reports[reports["outcome"] == Outcome.GATED]
    for number, source in enumerate(run.details.sources):
        times = np.sort(run.recording.seconds(gated["stamp_ns"][gated["source"] == number]))
        times_of_source = run.recording.seconds(reports["stamp_ns"][reports["source"] == number])
        for group in np.split(times, np.flatnonzero(np.diff(times) > _GROUP_GAP_S) + 1):
            if len(group):
                text = f"gate rejects {len(group)} of {source} within {np.ptp(group):.1f} s"
                begin, end = group[0] - _GROUP_GAP_S, group[-1] + _GROUP_GAP_S
                near = ((times_of_source > begin) & (times_of_source < end)).sum()
                level = Level.WARN if len(group) / max(int(near), 1) > _MAX_REJECTED_SHARE else Level.OK
                yield _make_event(float(group[0]), level, text)


def _explanation_events(run: Run) -> Iterator[Event]:
    """Competing explanations, and events that explain contradictions, without single outliers."""
    for interval in explanation_intervals(run):
        if interval.state == _SEVERAL_EXPLANATIONS:
            yield _make_event(interval.start, Level.WARN, interval.text)
    for event in run.replay.accepted_events:
        if event.event is not Explaining.OUTLIER:
            level = Level.OK if event.event is Explaining.RECOVERED or event.is_sector else Level.WARN
            yield _make_event(float(run.recording.seconds(np.array(event.stamp_ns))), level, event.text)


def _soil_events(run: Run) -> list[Event]:
    """Found soils."""
    numbers = run.numbers.get(SOIL)
    if numbers is None:
        return []
    events = Events()
    for k, at_s in enumerate(numbers.times.tolist()):
        is_identifiable = bool(numbers.rows["identifiable"][k])
        events.add_soil_change(numbers.classes_at(k), at_s, 1e3 * at_s, is_identifiable=is_identifiable)
    return list(events.recent)
