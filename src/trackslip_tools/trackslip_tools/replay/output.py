# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Outputs of a replay: a bag of the estimates, a text summary, and a JSON summary."""

import math
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.messages import make, serialize
from trackslip_bags.parameters import PARAMETERS_TOPIC, PARAMETERS_TYPE
from trackslip_bags.reader import Bag, absolute_name
from trackslip_bags.writer import BagWriter
from trackslip_common.config_files import parameters_text
from trackslip_common.parameters import to_flat
from trackslip_common.topics import (
    ATTITUDE,
    LOCAL_ODOMETRY,
    MACHINE_STATE,
    ODOMETRY,
    SWING_ESTIMATE,
    TRACK_SLIP,
)
from trackslip_common.vehicle_files import TOPIC as VEHICLE
from trackslip_common.vehicle_files import vehicle_text
from trackslip_estimation.slip import conversions
from trackslip_estimation.slip.estimator import Estimate, make_step
from trackslip_estimation.slip.events import Event
from trackslip_estimation.slip.learned import Learned, learned_context, to_tree
from trackslip_estimation.slip.learned_text import quantity_lines, to_json
from trackslip_estimation.slip.local_odometry import LocalOdometry
from trackslip_estimation.slip.parameters import NODE as SLIP_NODE
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.soil.soil_parameters import SoilEstimatorParameters
from trackslip_tools.check.bag import setup_summary
from trackslip_tools.replay.comparison import compared_parts, partial_comparison_lines
from trackslip_tools.replay.inputs import REPORTS
from trackslip_tools.replay.parts import EstimatorStart, Part, Watch, combine_watches
from trackslip_tools.replay.result import Replay
from trackslip_tools.replay.run import learned_before_bag, replay
from trackslip_tools.replay.soil import SoilReplay
from trackslip_tools.replay.soil_output import rejection_lines, soil_lines, soil_messages, soil_summary
from trackslip_tools.replay.stuck_tracks import stuck_track_lines
from trackslip_tools.terminal_text import number_text, wrap_line

_MOST_EVENTS = 12  # listed in the text
_PATH_NAMES = {"dead_reckoning": "encoders alone", "encoder_gyro": "encoders + gyro", "filter": "filter"}


class StampedWriter(BagWriter):
    """Writes messages and parameters of the slip estimator, each logged at its stamp."""

    def write_message(self, topic: str, message: Any, stamp_ns: int) -> None:
        """Write a message of any type."""
        self.write(absolute_name(topic), message.__msgtype__, serialize(message), stamp_ns)

    def write_parameters(self, p: SlipEstimatorParameters, stamp_ns: int, **sections: Any) -> None:
        """Write the parameters, with further ``sections`` such as ``learned``."""
        text = parameters_text(to_flat(p), SLIP_NODE, **sections)
        self.write_message(PARAMETERS_TOPIC, make(PARAMETERS_TYPE, data=text), stamp_ns)


class EstimateWriter(StampedWriter):
    """Writes a bag of the estimates, measurement reports and parameters.

    ``learned``: learned quantities from which the estimator started, if there are any.

    Raises:
        InputError: the path exists already.
    """

    def __init__(self, path: Path, p: SlipEstimatorParameters, learned: Learned | None = None) -> None:
        self._p = p
        self._start, self._begun = _learned_section(p, learned), False
        self._sequence, self._local = 0, LocalOdometry()  # loads kernels
        self._logged_ns: int | None = None
        super().__init__(path)

    def add(self, part: Part) -> None:
        """Write the results of a part."""
        if part.restart is not None:
            self._prepare_next_run(part.restart)
        names = map(part.sources.__getitem__, part.arrivals["source"].tolist())
        log_times_ns = part.arrivals["log_time_ns"].tolist()
        for record, source, log_time_ns in zip(part.results, names, log_times_ns, strict=True):
            report, estimate = make_step(record.item(), source)
            self._begin_run(report.stamp_ns)
            self._logged_ns = report.stamp_ns or self._logged_ns  # first inputs may have none
            message = conversions.measurement_report(make, report, self._sequence)
            self.write_message(REPORTS, message, self._logged_ns or log_time_ns)
            self._sequence += 1
            if estimate is not None:
                topics = [ODOMETRY, TRACK_SLIP, MACHINE_STATE]
                topics += [ATTITUDE] if estimate.outputs.tilt is not None else []
                topics += [SWING_ESTIMATE] if estimate.outputs.swing is not None else []
                for topic in topics:
                    self.write_message(topic, message_of(topic, estimate, self._p), estimate.stamp_ns)
                message = message_of(LOCAL_ODOMETRY, self._local.estimate_in_odom(estimate), self._p)
                self.write_message(LOCAL_ODOMETRY, message, estimate.stamp_ns)

    def add_soil(self, soil: SoilReplay) -> None:
        """Write the outputs of the soil estimator; called after the last part."""
        for topic, message, stamp_ns in soil_messages(soil):
            self.write_message(topic, message, stamp_ns)

    def _begin_run(self, stamp_ns: int) -> None:
        """Write the parameters at the first stamp of a run, and the vehicle at that of the first run."""
        if not self._begun and stamp_ns:
            self._begun = True
            self.write_parameters(self._p, stamp_ns, **self._start)
            if self._logged_ns is None:
                vehicle = make("std_msgs/msg/String", data=vehicle_text(self._p.vehicle))
                self.write_message(VEHICLE, vehicle, stamp_ns)

    def _prepare_next_run(self, start: EstimatorStart) -> None:
        """Prepare for another run of the estimator."""
        self._p, self._start = start.parameters, _learned_section(start.parameters, start.learned)
        self._sequence, self._local, self._begun = 0, LocalOdometry(), False


def replay_to_bag(
    path: Path | None,
    bag: Bag,
    p: SlipEstimatorParameters,
    filters: InputFilters,
    reference: str | None,
    soil_p: SoilEstimatorParameters | None,
    *watches: Watch,
) -> Replay:
    """Replay a bag and write the estimates to a new bag at ``path``; without a path only replay.

    Raises:
        InputError: as ``replay``, or the path exists already.
    """
    learned, _ = learned_before_bag(bag, p)
    with EstimateWriter(path, p, learned) if path else nullcontext() as writer:
        watch = combine_watches(*watches, *([writer.add] if writer else []))
        result = replay(bag, p, filters, reference, soil_p, watch)
        if writer and result.soil is not None:
            writer.add_soil(result.soil)
    return result


def _learned_section(p: SlipEstimatorParameters, learned: Learned | None) -> dict[str, Any]:
    return {} if learned is None else {"learned": to_tree(learned, learned_context(p))}


def message_of(topic: str, estimate: Estimate, p: SlipEstimatorParameters) -> Any:
    """The message that the live node publishes on a topic for an estimate."""
    frames = conversions.Frames(*p.frames)
    if topic in (ODOMETRY, LOCAL_ODOMETRY):
        parent = frames.map if topic == ODOMETRY else frames.odom
        return conversions.odometry(make, estimate, parent, frames.base)
    if topic == MACHINE_STATE:
        return conversions.machine_state(make, estimate, frames.map, frames.base)
    if topic == ATTITUDE:
        return conversions.attitude(make, estimate, frames.base)
    if topic == SWING_ESTIMATE:
        return conversions.swing(make, estimate, frames.base)
    return conversions.track_slip(make, estimate, frames.base)


def summary(result: Replay, elapsed_s: float) -> dict[str, Any]:
    """The contents of ``--json``; null where a value could not be computed.

    ``elapsed_s``: waiting time of the user.
    """
    scores = {name: result.scores.get(name) for name in _PATH_NAMES}
    rmse: dict[str, Any] = {name: score.position if score else None for name, score in scores.items()}
    rmse["heading"] = scores["filter"].heading if scores["filter"] else None
    rmse["slip"], rmse["swing"] = result.slip_rmse, result.swing_rmse
    rmse["attitude"], rmse["height"] = result.attitude_rmse, result.height_rmse
    if result.withheld:
        last = result.withheld[-1].as_dict()
        rmse["withheld"] = {"rmse": last["rmse"], "end": last["end"]}
    content = {
        "setup": result.setup.as_dict(),
        "vehicle": result.vehicle,
        "duration_s": result.duration_s,
        "messages": dict(sorted(result.messages.items())),
        "rejected": result.rejected.by_source(),
        "final": _final_values(result),
        "reference": result.reference,
        "rmse": rmse,
        "nees": result.nees,
        "nees_position": result.nees_position,
        "withheld": [withheld.as_dict() for withheld in result.withheld],
        "learned": to_json(result.findings) if result.learned else None,
        "explanations": [
            {
                "t": (h.stamp_ns - result.stamp_origin_ns) * 1e-9,
                "event": h.event.name.lower(),
                "source": h.source,
                "probability": h.probability,
            }
            for h in result.accepted_events
        ],
        "real_time_factor": result.duration_s / elapsed_s,
    }
    if result.live is not None:
        content["replay_matches"] = result.live.matches if result.live.compared else None
        content["replay_compared"] = compared_parts(result.live, result.start_ns)
    if result.soil is not None:
        content["soil"] = soil_summary(result.soil)
    return content


def text(result: Replay, elapsed_s: float) -> str:
    """The summary as lines for a terminal; ``elapsed_s``: waiting time of the user."""
    speed = result.duration_s / elapsed_s
    lines = [f"{result.duration_s:.1f} s replayed in {elapsed_s:.1f} s ({speed:.0f} × real time)"]
    lines += [f"  {topic:<24}{n:>8} messages" for topic, n in sorted(result.messages.items())]
    lines += rejection_lines(result.rejected)
    final = _final_values(result)
    if final is None:
        lines.append(f"no estimate: {result.no_estimate}")
    else:
        lines.append("final  " + "  ".join(f"{name} {value:.4f}" for name, value in final.items()))
        if result.no_estimate:
            lines.append(f"no estimate of the heading: {result.no_estimate}")
    lines += _stuck_track_lines(result)
    lines += map(str, result.withheld)
    lines += [result.start] if result.start else []
    lines += _event_lines(result)
    learned = quantity_lines(result.findings)
    lines += ["learned values of the machine and its ground"] if learned else []
    lines += [f"  {line}" for line in learned]
    lines += _score_lines(result)
    lines += _live_lines(result)
    if result.soil is not None:
        lines += soil_lines(result.soil)
    return "\n".join([setup_summary(result.setup), *map(wrap_line, lines)])


def _stuck_track_lines(result: Replay) -> list[str]:
    """Lines on tracks that stalled or got stuck, and on the longest time without fixes."""
    lines = stuck_track_lines(result.soil.forces, result.stamp_origin_ns) if result.soil is not None else []
    if result.longest_gap is not None:
        begin, end = result.longest_gap
        duration = f"{end - begin:.1f} s, from {begin:.1f} to {end:.1f} s"
        lines.append(f"longest time without an accepted fix {duration}")
    return lines


def _event_lines(result: Replay) -> list[str]:
    """Lines on the events that explain contradictions; single outliers are only counted."""
    events = [h for h in result.accepted_events if h.event is not Event.OUTLIER]
    outliers = len(result.accepted_events) - len(events)
    lines = [
        f"  {(h.stamp_ns - result.stamp_origin_ns) * 1e-9:8.1f} s  {h.text}" for h in events[:_MOST_EVENTS]
    ]
    lines += [f"  and {len(events) - _MOST_EVENTS} more"] if len(events) > _MOST_EVENTS else []
    lines += [f"  {outliers} single outliers"] if outliers else []
    return ["events that explain contradictions", *lines] if lines else []


def _final_values(result: Replay) -> dict[str, float] | None:
    if not len(result.last):
        return None
    last = result.last[0]
    x, y, yaw = last["pose"].tolist()
    left, right, _ = last["slips"].tolist()
    return {"x": x, "y": y, "yaw": yaw, "left_slip": left, "right_slip": right}


def _score_lines(result: Replay) -> list[str]:
    if result.reference is None:
        return ["no reference in the bag: nothing to score against (--reference TOPIC names one)"]
    lines = [f"{f'RMSE against {result.reference}':<34}{'position m':>12}{'heading rad':>14}"]
    for name, label in _PATH_NAMES.items():
        score = result.scores.get(name)
        values = (score.position, score.heading) if score else (None, None)
        position, heading = (number_text(value, ".4f") for value in values)
        lines.append(f"  {label:<32}{position:>12}{heading:>14}")
    if result.slip_rmse is not None:
        lines.append(f"  slip RMSE {result.slip_rmse:.4f}")
    if result.attitude_rmse is not None:
        degrees = math.degrees(result.attitude_rmse)
        lines.append(f"  attitude RMSE {degrees:.2f}°  height RMSE {result.height_rmse:.3f} m")
    if result.swing_rmse is not None:
        lines.append(f"  swing RMSE {result.swing_rmse:.4f} rad")
    if result.nees is not None:
        lines.append(f"  mean NEES of pose {result.nees:.2f} (3 if consistent)")
    elif result.nees_position is not None:
        lines.append(f"  mean NEES of position {result.nees_position:.2f} (2 if consistent)")
        lines.append("  the reference has no heading: positions are scored, dead reckoning has no beginning")
    return lines


def _live_lines(result: Replay) -> list[str]:
    live = result.live
    if live is None:
        return []
    lines = [str(live), *partial_comparison_lines(live, result.start_ns)]
    if live.lost_inputs:
        lines.append(f"  the bag lacks {live.lost_inputs} measurements that the live estimator processed")
    if live.disordered_reports:
        number = live.disordered_reports
        lines.append(f"  the bag merges recordings of several runs: {number} lines of the live estimator's")
        lines.append("  journal are out of order; replay each recording alone")
    elif live.lost_reports:
        lines.append(f"  the bag lacks {live.lost_reports} lines of the live estimator's journal")
    return lines
