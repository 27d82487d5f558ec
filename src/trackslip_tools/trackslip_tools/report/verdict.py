# SPDX-License-Identifier: Apache-2.0
"""What a run is worth, in plain words: each check is ok, asks for attention, or could not be made."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from trackslip_common.parameters import to_flat
from trackslip_common.topics import SENSOR_TOPICS
from trackslip_estimation.slip.measurements import Outcome
from trackslip_tools.replay.inputs import SPROCKETS
from trackslip_tools.report.innovations import innovations_of
from trackslip_tools.report.quantities import SOIL
from trackslip_tools.report.run import Run

_POSITION = 0.15  # m, RMSE
_GAIN = 0.2  # of the error of encoders alone
_SLIP = 0.05  # RMSE
_CONSISTENT = (0.5, 1.5)  # errors over what was claimed of them; 1 is consistent
_SHARE = 0.01  # of messages lost, of measurements refused


class State(Enum):
    """What a check came to."""

    OK = "ok"
    ATTENTION = "attention"
    UNKNOWN = "not checked"


@dataclass(frozen=True)
class Verdict:
    """One check of one run."""

    state: State
    value: str  # the number, short
    words: str  # what it means


def verdicts(run: Run) -> dict[str, Verdict]:
    """All checks, by name, in the order of the table."""
    checks: dict[str, Callable[[Run], Verdict]] = {
        "Bag": _intact,
        "Replay = live": _same_as_live,
        "Position": _position,
        "Consistency of the pose": _pose_consistency,
        "Consistency of the innovations": _innovation_consistency,
        "Slip": _slip,
        "Soil": _soil,
        "Rates": _rates,
        "Gaps": _gaps,
        "Rejections": _rejections,
    }
    return {name: check(run) for name, check in checks.items()}


def _checked(good: bool, value: str, words: str) -> Verdict:
    return Verdict(State.OK if good else State.ATTENTION, value, words)


def _unknown(words: str) -> Verdict:
    return Verdict(State.UNKNOWN, "–", words)


def _intact(run: Run) -> Verdict:
    if run.recording.damage:
        return _checked(False, "damaged", f"Only what was whole could be read ({run.recording.damage}).")
    return _checked(True, "whole", "The recording was closed properly.")


def _same_as_live(run: Run) -> Verdict:
    live, carried = run.replay.live, run.recording.parameters
    if run.filters.changes_inputs:
        return _unknown("The estimator was given other measurements than live.")
    if live is None:
        return _unknown("The bag holds no live estimates.")
    if any(carried.get(name, value) != value for name, value in to_flat(run.parameters).items()):
        return _unknown("Replayed with other parameters than live.")
    soil = run.replay.soil.live if run.replay.soil is not None else None
    if soil is not None and live.matches and not soil.matches:
        return _checked(False, f"{soil.compared} soil messages", "The soil estimator differed live.")
    value = f"{live.compared} estimates, largest difference {live.largest_difference:.0e}"
    if live.matches:
        return _checked(True, value, "The replay repeats what the machine computed.")
    lost = f"{live.unmatched} unmatched, {live.lost_inputs} measurements and {live.lost_reports} reports lost"
    return _checked(False, value, f"The machine computed something else ({lost}).")


def _position(run: Run) -> Verdict:
    if run.states is None:
        why = run.replay.no_estimate or "Nothing to start from: no fix, no initial pose"
        return _checked(False, "no estimate", f"{why[0].upper()}{why[1:]}.")
    own, encoders = (run.replay.scores.get(name) for name in ("filter", "dead_reckoning"))
    if own is None:
        return _unknown("No reference in the bag (--reference names one).")
    turned = "" if own.heading is None else f", {math.degrees(own.heading):.2f}°"
    value = f"{100.0 * own.position:.1f} cm{turned} RMSE"
    if run.replay.no_estimate:
        return _checked(False, value, f"No heading: {run.replay.no_estimate}.")
    if encoders is None:
        return _checked(own.position <= _POSITION, value, f"Against {run.replay.reference}.")
    words = f"Encoders alone: {100.0 * encoders.position:.1f} cm. Wanted: {100.0 * _POSITION:g} cm, "
    good = own.position <= _POSITION and own.position <= _GAIN * encoders.position
    return _checked(good, value, f"{words}and at most {_GAIN:g} of the encoders' error.")


def _pose_consistency(run: Run) -> Verdict:
    pose, position = run.replay.nees, run.replay.nees_position
    if pose is not None:
        return _consistency(pose / 3.0, f"NEES {pose:.2f}, 3 expected", "Errors of the pose")
    if position is not None:
        value = f"NEES of the position {position:.2f}, 2 expected"
        return _consistency(position / 2.0, value, "Errors of the position (the reference has no heading)")
    return _unknown("No reference in the bag.")


def _innovation_consistency(run: Run) -> Verdict:
    ratios = {source: found.mean_ratio for source, found in innovations_of(run).items()}
    ratios = {source: ratio for source, ratio in ratios.items() if math.isfinite(ratio)}
    if not ratios:
        return _unknown("No measurement was compared with the estimate.")
    worst = max(ratios, key=lambda source: abs(math.log(max(ratios[source], 1e-9))))
    value = ", ".join(f"{source} {ratio:.2f}" for source, ratio in ratios.items())
    return _consistency(ratios[worst], f"NIS / dof: {value}", f"Innovations of {worst}")


def _consistency(ratio: float, value: str, what: str) -> Verdict:
    """``ratio``: squared errors over what was claimed."""
    times = math.sqrt(ratio)
    words = f"{what} are {times:.2f} times what the estimate claims"
    if times > _CONSISTENT[1]:
        return _checked(False, value, f"{words}: it is too sure.")
    if times < _CONSISTENT[0]:
        return _checked(False, value, f"{words}: it is too modest.")
    return _checked(True, value, f"{words}.")


def _slip(run: Run) -> Verdict:
    if run.replay.slip_rmse is None:
        return _unknown("The bag holds no true slips.")
    words = f"Wanted: at most {_SLIP:g}, left and right together, while the machine moves."
    return _checked(run.replay.slip_rmse <= _SLIP, f"{run.replay.slip_rmse:.4f} RMSE", words)


def _soil(run: Run) -> Verdict:
    numbers = run.numbers.get(SOIL)
    if numbers is None:
        return _unknown("Neither hydraulics nor soil estimates in the bag.")
    last = numbers.rows[-1]
    value = f"K {100.0 * last['shear_modulus']:.2f} cm, F_max {1e-3 * last['max_tractive_effort']:.1f} kN"
    if last["identifiable"]:
        return _checked(True, value, "The driving determines K and F_max separately.")
    return _checked(False, value, f"Not separated yet: {numbers.reason or 'no reason given'}.")


def _rates(run: Run) -> Verdict:
    timings = {name: run.recording.timings[name] for name in _sensors(run)}
    lost = {name: timing.lost for name, timing in timings.items() if timing.regular}
    if not lost:
        return _checked(False, "no sensor", "No sensor topic holds messages.")
    value = f"{len(lost)} sensors, at worst {100.0 * max(lost.values()):.1f} % lost"
    bad = [f"{name} {100.0 * share:.1f} %" for name, share in lost.items() if share > _SHARE]
    words = f"Lost: {', '.join(bad)}." if bad else "Every sensor came at its usual rate."
    return _checked(not bad, value, words)


def _gaps(run: Run) -> Verdict:
    """Silence longer than the estimator's own timeouts."""
    p, timings = run.parameters, run.recording.timings
    allowed = {name: timeout_ns * 1e-9 for name, timeout_ns in p.timeouts_ns().items()}
    allowed[SPROCKETS] = p.sprocket_timeout
    longest = {name: timings[name].longest for name in allowed if name in timings and timings[name].gaps}
    if not longest:
        return _checked(True, "none", "No source of the estimator was silent.")
    worst = max(longest, key=lambda name: longest[name] / allowed[name])
    bad = [name for name in longest if longest[name] > allowed[name]]
    words = f"Longer than its timeout: {', '.join(bad)}." if bad else "None longer than its source's timeout."
    return _checked(not bad, f"{worst} {longest[worst]:.2f} s", words)


def _rejections(run: Run) -> Verdict:
    """Before the start every measurement is refused; that is no fault, if there is a start."""
    waiting = Outcome.WAITING.name.lower()
    by_source = run.replay.rejected.by_source()
    early = sum(reasons.get(waiting, 0) for reasons in by_source.values())
    if run.states is None:
        total = sum(sum(reasons.values()) for reasons in by_source.values())
        return _checked(False, f"all {total}", "No measurement was used: there is no estimate.")
    refused = {
        source: sum(n for reason, n in reasons.items() if reason != waiting)
        for source, reasons in by_source.items()
    }
    shares = {
        source: count / max(run.replay.messages.get(source, count), 1)
        for source, count in refused.items()
        if count
    }
    if not shares:
        if early:
            return _checked(True, f"{early} before the start", "Since the start every measurement was used.")
        return _checked(True, "none", "Every measurement was used.")
    value = ", ".join(f"{source} {100.0 * share:.2f} %" for source, share in shares.items())
    good = max(shares.values()) <= _SHARE
    return _checked(good, value, f"Share not used; {100.0 * _SHARE:g} % of a source is normal.")


def _sensors(run: Run) -> list[str]:
    sources = {*SENSOR_TOPICS, *run.parameters.timeouts_ns()}
    return sorted(sources & run.recording.timings.keys())
