# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Checks of a run with results in words: ok, attention, information, or not checked."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum

from trackslip_common.config_files import config_file, load_parameters, node_parameters, read_yaml
from trackslip_common.errors import InputError
from trackslip_common.parameters import Parameters, parameter, to_flat
from trackslip_common.topics import SENSOR_TOPICS, SOIL
from trackslip_tools.replay.no_estimate import count_since_start
from trackslip_tools.report.innovations import innovations_of
from trackslip_tools.report.quantities import PERCENT
from trackslip_tools.report.run import Run
from trackslip_tools.report.timeline import silence_limits, stuck_track_intervals, stuck_tracks_text
from trackslip_tools.terminal_text import NO_VALUE

SECTION = "report"
DEFAULT_FILES = ("report.yaml",)


@dataclass(frozen=True, kw_only=True)
class VerdictLimits(Parameters):
    """See ``config/report.yaml``."""

    position: float = parameter("largest RMSE of the position", unit="m", gt=0.0)
    encoders: float = parameter("largest ratio of the position RMSE to that of encoders alone", gt=0.0)
    slip: float = parameter("largest RMSE of the slips", gt=0.0)
    least_consistency: float = parameter(
        "smallest ratio of errors to their standard deviations in the estimate", ge=0.0, lt=1.0
    )
    most_consistency: float = parameter(
        "largest ratio of errors to their standard deviations in the estimate", gt=1.0
    )
    lost: float = parameter("largest share of lost messages", ge=0.0, lt=1.0)
    refused: float = parameter("largest share of unused measurements", ge=0.0, lt=1.0)
    slip_stddev: float = parameter("largest standard deviation of a slip that counts as known", gt=0.0)


def load_limits(files: Sequence[str] = ()) -> VerdictLimits:
    """Limits of ``config/``, overridden by these files.

    Raises:
        InputError: a file is missing or has no section ``report``, a name is unknown, or a value is rejected.
    """
    layers = []
    for name in files:
        path = config_file(name)
        layers.append(node_parameters(read_yaml(path), SECTION, str(path)))
        if not layers[-1]:
            raise InputError(f"{path}: no limits; accepted: a section '{SECTION}' as in config/report.yaml")
    return load_parameters(VerdictLimits, SECTION, DEFAULT_FILES, *layers)


class State(Enum):
    """Result of a check."""

    OK = "ok"
    ATTENTION = "attention"
    INFORMATION = "information"  # no action needed
    UNKNOWN = "not checked"


@dataclass(frozen=True)
class Verdict:
    """One check of one run with its result."""

    state: State
    value: str  # the number, short
    words: str  # explanation


Check = Callable[[Run, VerdictLimits], Verdict]


def verdicts(run: Run, limits: VerdictLimits) -> dict[str, Verdict]:
    """All checks by name, in the order of the table."""
    checks: dict[str, Check] = {
        "Setup plausible": _check_setup,
        "Bag": _check_bag,
        "Replay = live": _check_live,
        "Position": _check_position,
        "Consistency of the pose": _check_pose_consistency,
        "Consistency of the innovations": _check_innovations,
        "Slip": _check_slip,
        "Tracks": _check_tracks,
        "Soil": _check_soil,
        "Rates": _check_rates,
        "Gaps": _check_gaps,
        "Rejections": _check_rejections,
    }
    return {name: check(run, limits) for name, check in checks.items()}


def _make_verdict(is_good: bool, value: str, words: str) -> Verdict:
    return Verdict(State.OK if is_good else State.ATTENTION, value, words)


def _unchecked(words: str) -> Verdict:
    return Verdict(State.UNKNOWN, NO_VALUE, words)


def _check_setup(run: Run, _: VerdictLimits) -> Verdict:
    """Check the setup: tracks, inertial unit and fixes agree."""
    setup = run.replay.setup
    if setup.causes:
        words = "; ".join(f"{cause.evidence}. {cause.remedy}" for cause in setup.causes)
        return _make_verdict(False, ", ".join(cause.cause for cause in setup.causes), f"{words}.")
    if setup.open_questions:
        return _make_verdict(False, "undecided", f"{setup.headline}.")
    if not setup.facts:
        return _unchecked("The drive is too short for the setup check.")
    questions = "; ".join(f"{one.what}: {one.needed}" for one in setup.undetermined)
    agree = "Tracks, inertial unit and fixes agree."
    return _make_verdict(True, "no cause found", f"{agree} Not decided: {questions}." if questions else agree)


def _check_bag(run: Run, _: VerdictLimits) -> Verdict:
    if run.recording.damage:
        return _make_verdict(
            False, "damaged", f"Only the undamaged part could be read ({run.recording.damage})."
        )
    return _make_verdict(True, "whole", "The recording was closed properly.")


def _check_live(run: Run, _: VerdictLimits) -> Verdict:
    live, bag_parameters = run.replay.live, run.recording.parameters
    if run.filters.changes_inputs:
        return _unchecked("The estimator was given other measurements than live.")
    if live is None:
        return _unchecked("The bag holds no live estimates.")
    if any(bag_parameters.get(name, value) != value for name, value in to_flat(run.parameters).items()):
        return _unchecked("Replayed with other parameters than live.")
    breaks = live.comparability.breaks
    if not live.compared and breaks:
        return _unchecked(f"Nothing can be compared: {breaks[0].why}.")
    soil = run.replay.soil.live if run.replay.soil is not None else None
    if soil is not None and live.matches and not soil.matches:
        return _make_verdict(False, f"{soil.compared} soil messages", "The soil estimator differed live.")
    value = f"{live.compared} estimates, largest difference {live.largest_difference:.0e}"
    if live.matches:
        as_far_as = f", but not from where {breaks[0].why}" if breaks else ""
        return _make_verdict(True, value, f"The replay repeats what the machine computed{as_far_as}.")
    lost = f"lost measurements: {live.lost_inputs}, lost reports: {live.lost_reports}"
    return _make_verdict(
        False, value, f"Replay and live estimates differ (unmatched: {live.unmatched}, {lost})."
    )


def _check_position(run: Run, limits: VerdictLimits) -> Verdict:
    if run.states is None:
        why = run.replay.no_estimate or "Nothing to start from: no fix, no initial pose"
        return _make_verdict(False, "no estimate", f"{why[0].upper()}{why[1:]}.")
    score, encoders = (run.replay.scores.get(name) for name in ("filter", "dead_reckoning"))
    if score is None:
        return _unchecked("No reference in the bag (--reference names one).")
    heading = "" if score.heading is None else f", {math.degrees(score.heading):.2f}°"
    value = f"{100.0 * score.position:.1f} cm{heading} RMSE"
    if run.replay.no_estimate:
        return _make_verdict(False, value, f"No heading: {run.replay.no_estimate}.")
    if encoders is None:
        return _make_verdict(score.position <= limits.position, value, f"Against {run.replay.reference}.")
    words = f"Encoders alone: {100.0 * encoders.position:.1f} cm. Required: {100.0 * limits.position:g} cm, "
    is_good = score.position <= min(limits.position, limits.encoders * encoders.position)
    return _make_verdict(
        is_good, value, f"{words}and at most {100.0 * limits.encoders:g} % of the encoders' error."
    )


def _check_pose_consistency(run: Run, limits: VerdictLimits) -> Verdict:
    pose, position = run.replay.nees, run.replay.nees_position
    if pose is not None:
        return _rate_consistency(limits, pose / 3.0, f"NEES {pose:.2f}, 3 expected", "Errors of the pose")
    if position is not None:
        value = f"NEES of the position {position:.2f}, 2 expected"
        what = "Errors of the position (the reference has no heading)"
        return _rate_consistency(limits, position / 2.0, value, what)
    return _unchecked("No reference in the bag.")


def _check_innovations(run: Run, limits: VerdictLimits) -> Verdict:
    ratios = {source: innovations.mean_ratio for source, innovations in innovations_of(run).items()}
    ratios = {source: ratio for source, ratio in ratios.items() if math.isfinite(ratio)}
    if not ratios:
        return _unchecked("No measurement was compared with the estimate.")
    worst = max(ratios, key=lambda source: abs(math.log(max(ratios[source], 1e-9))))
    value = ", ".join(f"{source} {ratio:.2f}" for source, ratio in ratios.items())
    return _rate_consistency(limits, ratios[worst], f"NIS / dof: {value}", f"Innovations of {worst}")


def _rate_consistency(limits: VerdictLimits, ratio: float, value: str, what: str) -> Verdict:
    """Check consistency; ``ratio``: mean squared error over its variance in the estimate."""
    times = math.sqrt(ratio)
    words = f"{what} are {times:.2f} times what the estimate claims"
    if times > limits.most_consistency:
        return _make_verdict(False, value, f"{words}: it is overconfident.")
    if times < limits.least_consistency:
        words = f"{words}: sensors are better than stated (harmless)"
        return Verdict(State.INFORMATION, value, f"{words}.")
    return _make_verdict(True, value, f"{words}.")


def _check_slip(run: Run, limits: VerdictLimits) -> Verdict:
    if run.replay.slip_rmse is None:
        return _unchecked("The bag holds no true slips.")
    words = f"Required: at most {PERCENT * limits.slip:g} %, left and right together, while they turn."
    is_good = run.replay.slip_rmse <= limits.slip
    return _make_verdict(is_good, f"{PERCENT * run.replay.slip_rmse:.2f} % RMSE", words)


def _check_tracks(run: Run, _: VerdictLimits) -> Verdict:
    """Check that the tracks turned when commanded, without getting stuck."""
    intervals = stuck_track_intervals(run)
    if not intervals:
        return _unchecked("Neither hydraulics nor estimates of forces: stuck tracks cannot be detected.")
    troubles = stuck_tracks_text(intervals)
    if troubles:
        return _make_verdict(
            False, troubles, "Stalled: commanded and under pressure, not turning. Stuck: spinning."
        )
    return _make_verdict(True, "none", "No track was stalled or getting stuck.")


def _check_soil(run: Run, _: VerdictLimits) -> Verdict:
    numbers = run.numbers.get(SOIL)
    if numbers is None:
        return _unchecked("Neither hydraulics nor soil estimates in the bag.")
    last = numbers.rows[-1]
    value = f"K {100.0 * last['shear_modulus']:.2f} cm, F_max {1e-3 * last['max_tractive_effort']:.1f} kN"
    if last["identifiable"]:
        return _make_verdict(True, value, "The driving determines K and F_max separately.")
    return Verdict(State.INFORMATION, value, f"Not separated yet: {numbers.reason or 'no reason given'}.")


def _check_rates(run: Run, limits: VerdictLimits) -> Verdict:
    timings = {name: run.recording.timings[name] for name in _sensor_topics(run)}
    lost = {name: timing.lost_share for name, timing in timings.items() if timing.is_regular}
    if not lost:
        return _make_verdict(False, "no sensor", "No sensor topic holds messages.")
    value = f"{len(lost)} sensors, at worst {PERCENT * max(lost.values()):.1f} % lost"
    bad = [f"{name} {PERCENT * share:.1f} %" for name, share in lost.items() if share > limits.lost]
    words = f"Lost: {', '.join(bad)}." if bad else "Every sensor published at its usual rate."
    return _make_verdict(not bad, value, words)


def _check_gaps(run: Run, _: VerdictLimits) -> Verdict:
    """Check for silence beyond which a source counts as lost."""
    timings, limits = run.recording.timings, silence_limits(run)
    longest = {
        name: timings[name].longest_interval for name in limits if name in timings and timings[name].gaps
    }
    if not longest:
        return _make_verdict(True, "none", "No source of the estimator was silent.")
    worst = max(longest, key=lambda name: longest[name] / limits[name])
    bad = [name for name in longest if longest[name] > limits[name]]
    words = (
        f"Lost: {', '.join(bad)}."
        if bad
        else "None was lost: silent for longer than its timeout and three periods."
    )
    return _make_verdict(not bad, f"{worst} {longest[worst]:.2f} s", words)


def _check_rejections(run: Run, limits: VerdictLimits) -> Verdict:
    """Check the share of rejected measurements; those before the start do not count, if there is a start."""
    rejected = run.replay.rejected_by_source
    total = sum(sum(reasons.values()) for reasons in rejected.values())
    if run.states is None:
        return _make_verdict(False, f"all {total}", "No measurement was used: there is no estimate.")
    shares = {
        source: count / max(run.replay.messages.get(source, count), 1)
        for source, reasons in rejected.items()
        if (count := count_since_start(reasons))
    }
    if not shares:
        return _make_verdict(True, *_all_used_texts(run, total))
    value = ", ".join(f"{source} {PERCENT * share:.2f} %" for source, share in shares.items())
    is_good = max(shares.values()) <= limits.refused
    return _make_verdict(
        is_good, value, f"Share not used; {PERCENT * limits.refused:g} % of a source is normal."
    )


def _all_used_texts(run: Run, early: int) -> tuple[str, str]:
    """Value and words for a run without rejections since the start; ``early``: rejections before it."""
    replayed = "replayed " if run.filters.changes_inputs else ""
    hidden = sum(withheld.messages for withheld in run.replay.withheld)
    withheld_note = f" {hidden} were withheld." if hidden else ""
    if early:
        return (
            f"{early} before the start",
            f"Since the start every {replayed}measurement was used.{withheld_note}",
        )
    return "none", f"Every {replayed}measurement was used.{withheld_note}"


def _sensor_topics(run: Run) -> list[str]:
    sources = {*SENSOR_TOPICS, *run.parameters.timeouts_ns()}
    return sorted(sources & run.recording.timings.keys())
