# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The setup check of a bag, in its own pass or during a replay, and its result as text."""

import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace

from numpy.lib.stride_tricks import sliding_window_view

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.reader import Bag
from trackslip_common.errors import joined_names
from trackslip_common.tally import Tally
from trackslip_common.topics import LEFT_SPROCKET, RIGHT_SPROCKET
from trackslip_estimation.setup_check.check import check
from trackslip_estimation.setup_check.collect import LONG_PAUSE_NS, Collector
from trackslip_estimation.setup_check.finding import READ_OFF, Cause, OpenQuestion, Result, odds_text
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.sources import Rejection
from trackslip_estimation.soil.records import HYDRAULICS
from trackslip_estimation.soil.soil_parameters import load_soil_parameters
from trackslip_tools.replay.inputs import SPROCKETS, Batch, InputStream
from trackslip_tools.terminal_text import table, wrap_line

_SET_BACK_NS = 1_000_000_000  # by less, messages of several threads are out of order
_SAMPLES_APART = 5  # before and after stamps that go back: single ones may be stray
_LEAST_GATED = 20  # measurements of a source
_SETTING = re.compile(r"\bslip_estimator\.[\w.]+=[^\s,;]+")


def check_bag(
    bag: Bag,
    p: SlipEstimatorParameters,
    filters: InputFilters | None = None,
    advance: Callable[[float], None] = lambda _: None,
    tables: Collection[str] = (),
    watch: Callable[[Batch], None] = lambda _: None,
) -> Result:
    """Check a bag: causes and undecided questions; ``advance`` gets the seconds read.

    ``watch`` gets each batch of the bag, with the ``tables`` of further topics.

    Raises:
        InputError: the bag lacks the sprockets, or is damaged.
    """
    stream = InputStream(bag, p, filters or InputFilters(), {*tables, HYDRAULICS})
    collector = Collector(p, load_soil_parameters().watch)
    reached = 0.0
    for batch in stream:
        collector.add(batch.rows, stream.sources)
        if HYDRAULICS in batch.tables:
            collector.add_hydraulics(batch.tables[HYDRAULICS].rows)
        watch(batch)
        advance(max(stream.duration_s - reached, 0.0))
        reached = max(reached, stream.duration_s)
    return check_collected(collector, stream)


def check_collected(collector: Collector, stream: InputStream) -> Result:
    """Result of the check over the collected measurements, and of sources whose messages become none."""
    log = collector.log()
    result = Result(undetermined=(_no_sprockets(stream),)) if log is None else check(log)
    set_back = _recorder_set_back(stream) or _stamps_set_back(collector, stream.start_ns)
    if set_back:  # two times are mixed: other findings are of no drive
        result = replace(result, causes=(), undetermined=())
    causes = (*result.causes, *_invalid_sources(stream), *set_back)
    has_times = all(cause.cause != "time_unit" for cause in causes)  # else each step may be hours
    return replace(result, causes=causes, notes=tuple(_long_pause(stream)) if has_times else ())


def with_gated_sources(result: Result, input_counts: Mapping[str, int], rejected: Tally) -> Result:
    """A plausible result with a question for each source of which a replay gated most measurements.

    ``input_counts``: measurements of each source.
    """
    gated = Outcome.GATED.name.lower()
    counts = {source: n for (source, reason), n in rejected.total.items() if reason == gated}
    questions = [
        OpenQuestion(
            f"{source}: {n} of {input_counts[source]} measurements were rejected, far from the estimate",
            "check its units, axes, mounting and variances; turns by 90° each way show which is wrong",
            is_wrong=True,
        )
        for source, n in counts.items()
        if n >= _LEAST_GATED and 2 * n > input_counts[source]
    ]
    return replace(result, undetermined=(*result.undetermined, *questions)) if result.is_plausible else result


def _no_sprockets(stream: InputStream) -> OpenQuestion:
    """The question that no drive without speeds decides, with what the first message of the sprockets has."""
    message = stream.first_message(SPROCKETS)
    found = ""
    if message is not None:
        counts = f"velocities: {len(message.velocity)}, positions: {len(message.position)}"
        found = f" (joints {joined_names(message.name) or 'without names'}; {counts})"
    return OpenQuestion(
        f"everything: there is no valid speed of the sprockets{found}",
        f"record the topic sprockets with the velocities of {LEFT_SPROCKET} and {RIGHT_SPROCKET} in each "
        "message; trackslip import makes it of other joints, or of positions (docs/import.md)",
        is_wrong=True,
    )


def _invalid_sources(stream: InputStream) -> list[Cause]:
    """A cause for each source of which no message has a measurement."""
    reasons = {reason.value for reason in Rejection}
    return [
        Cause(
            "invalid_readings",
            source,
            f"all {count} messages of {source} are {reason}",
            READ_OFF,
            f"Leave {source} out of the sources of the slip estimator, or let its driver measure it",
        )
        for (source, reason), count in stream.rejected.total.items()
        if reason in reasons and count == stream.messages[source]
    ]


def _recorder_set_back(stream: InputStream) -> list[Cause]:
    """A cause if the clock of the recorder was set back: readings of two times are mixed."""
    twice, exchanged = stream.passed_twice, stream.exchanged_parts
    if exchanged is not None:
        end, begin = ((t - stream.start_ns) * 1e-9 for t in exchanged)
        evidence = (
            f"was set back: it recorded what it logged from {begin:.1f} s of the bag on before the rest"
        )
        how = f"Replay --start {begin - 0.1:.1f}, and --stop {end + 0.1:.1f} by itself"
    elif twice is not None and twice.end_ns - twice.begin_ns >= _SET_BACK_NS:
        begin, end = ((t - stream.start_ns) * 1e-9 for t in twice)
        evidence = f"was set back: it passed {begin:.1f} s to {end:.1f} s of the bag twice"
        how = f"Replay --stop {begin:.1f}, and --start {end:.1f} by itself"
    else:
        return []
    evidence, remedy = f"the recorder's clock {evidence}", f"{how}; set the clock before a drive"
    return [Cause("clock_set_back", "recorder", evidence, READ_OFF, remedy)]


def _stamps_set_back(collector: Collector, start_ns: int) -> list[Cause]:
    """A cause if the sprockets' stamps go back for good, as those of a simulation that starts again do."""
    times = collector.sprocket_times()
    if len(times) < 2 * _SAMPLES_APART:
        return []
    spans = sliding_window_view(times[:, 0], _SAMPLES_APART)
    back_ns = spans.min(axis=1)[:-_SAMPLES_APART] - spans.max(axis=1)[_SAMPLES_APART:]
    k = int(back_ns.argmax())
    if back_ns[k] < _SET_BACK_NS:
        return []
    last, first = times[k + _SAMPLES_APART - 1 : k + _SAMPLES_APART + 1]
    end, begin = ((log_time_ns - start_ns) * 1e-9 for log_time_ns in (last[1], first[1]))
    evidence = (
        f"stamps of the sprockets go back by {(last[0] - first[0]) * 1e-9:.1f} s at {end:.1f} s of the bag"
    )
    remedy = (
        f"Replay --stop {end:.2f}, and --start {begin:.2f} by itself; record each run of a simulation alone"
    )
    return [Cause("clock_set_back", SPROCKETS, evidence, READ_OFF, remedy)]


def _long_pause(stream: InputStream) -> list[str]:
    """A line if no sprocket sample was logged for hours, with the commands for the drive on each side."""
    pause = stream.longest_pause if stream.exchanged_parts is None else None
    if pause is None or pause.end_ns - pause.begin_ns < LONG_PAUSE_NS:
        return []
    begin, end = ((t - stream.start_ns) * 1e-9 for t in pause)
    why = "the recorder paused, or the clock was set"
    how = f"--stop {begin + 0.1:.1f} and --start {end - 0.1:.1f} of replay and report show each part"
    return [f"no sprockets for {_duration_text(end - begin)} from {begin:.1f} s on: {why}; {how}"]


def _duration_text(duration_s: float) -> str:
    days = duration_s / 86_400.0
    if days < 2.0:
        return f"{24.0 * days:.1f} h"
    return f"{days:.0f} days" if days < 730.0 else f"{days / 365.25:.1f} years"


def remedy_settings(result: Result) -> list[str]:
    """Settings of the remedies, for ``--set``; empty if a cause has another remedy."""
    settings_by_cause = [_SETTING.findall(cause.remedy) for cause in result.causes]
    return [one for settings in settings_by_cause for one in settings] if all(settings_by_cause) else []


def setup_summary(result: Result) -> str:
    """Summary for other commands: notes, causes and remedies, else open questions or "setup plausible"."""
    lines = [*result.notes]
    if not result.causes:
        lines += [f"setup: {one.what}: {one.needed}" for one in result.open_questions] or ["setup plausible"]
    for cause in result.causes:
        lines += [f"setup: {cause.cause} ({cause.source}): {cause.evidence}", f"  {cause.remedy}"]
    return "\n".join(map(wrap_line, lines))


def setup_report(result: Result) -> str:
    """Full text for ``trackslip check``: facts, causes with odds and remedies, and undecided questions."""
    facts = [*result.facts, *(result.notes if result.causes else ())]
    parts = ["\n".join(map(wrap_line, facts))] if facts else []
    if result.causes:
        rows = [(c.cause, c.source, odds_text(c.odds)) for c in result.causes]
        parts.append(table(("cause", "source", "odds"), rows, (False, False, True)))
        parts += [
            "\n".join(map(wrap_line, (f"{c.cause}: {c.evidence}", f"  {c.remedy}"))) for c in result.causes
        ]
    else:
        parts.append(setup_summary(result))
    stated = () if result.causes else result.open_questions
    if remaining := [one for one in result.undetermined if one not in stated]:
        lines = [f"  {one.what}: {one.needed}" for one in remaining]
        parts.append("\n".join(["not decided by this drive", *map(wrap_line, lines)]))
    return "\n\n".join(parts)
