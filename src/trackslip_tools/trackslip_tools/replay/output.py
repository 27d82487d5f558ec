# SPDX-License-Identifier: Apache-2.0
"""What a replay leaves behind: a bag of its estimates, a summary for people, and one for programs."""

from pathlib import Path
from typing import Any

from trackslip_bags.messages import make, serialize
from trackslip_bags.parameters import PARAMETERS_TOPIC
from trackslip_bags.reader import absolute
from trackslip_bags.writer import BagWriter
from trackslip_common.config_files import parameters_text
from trackslip_common.parameters import to_flat
from trackslip_common.topics import TOPICS
from trackslip_common.vehicle import TOPIC as VEHICLE
from trackslip_common.vehicle import vehicle_text
from trackslip_estimation.slip import conversions
from trackslip_estimation.slip.estimator import Estimate, make_step
from trackslip_estimation.slip.parameters import NODE as SLIP_NODE
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_tools.replay.inputs import ODOMETRY, REPORTS, TRACK_SLIP
from trackslip_tools.replay.run import Part, Replay
from trackslip_tools.replay.soil import SoilReplay
from trackslip_tools.replay.soil_output import soil_lines, soil_messages, soil_summary

_NAMES = {"dead_reckoning": "encoders alone", "encoder_gyro": "encoders + gyro", "filter": "filter"}


class EstimateWriter:
    """A bag of the estimates, the report on each measurement and the parameters, each logged at its stamp.

    Raises:
        InputError: the path exists already.
    """

    def __init__(self, path: Path, p: SlipEstimatorParameters) -> None:
        self._bag, self._p = BagWriter(path), p
        self._sequence = 0
        self._logged_ns: int | None = None

    def __enter__(self) -> "EstimateWriter":
        self._bag.__enter__()
        return self

    def __exit__(self, *raised: Any) -> None:
        self._bag.__exit__(*raised)

    def add(self, part: Part) -> None:
        """More of a replay."""
        names = map(part.sources.__getitem__, part.arrivals["source"].tolist())
        for record, source in zip(part.results, names, strict=True):
            report, estimate = make_step(record.item(), source)
            self._begin(report.stamp_ns)
            self._logged_ns = report.stamp_ns or self._logged_ns  # commands have no stamp
            message = conversions.measurement_report(make, report, self._sequence)
            self._write(REPORTS, message, self._logged_ns or 0)
            self._sequence += 1
            if estimate is not None:
                for topic in (ODOMETRY, TRACK_SLIP):
                    self._write(topic, message_of(topic, estimate, self._p), estimate.stamp_ns)

    def add_soil(self, soil: SoilReplay) -> None:
        """What the soil estimator gave, when all is done."""
        for topic, message, stamp_ns in soil_messages(soil):
            self._write(topic, message, stamp_ns)

    def _begin(self, stamp_ns: int) -> None:
        """With the parameters, at the first stamp."""
        if self._logged_ns is None and stamp_ns:
            text = make("std_msgs/msg/String", data=parameters_text(to_flat(self._p), SLIP_NODE))
            self._write(PARAMETERS_TOPIC, text, stamp_ns)
            vehicle = make("std_msgs/msg/String", data=vehicle_text(self._p.vehicle))
            self._write(VEHICLE, vehicle, stamp_ns)

    def _write(self, topic: str, message: Any, stamp_ns: int) -> None:
        self._bag.write(absolute(topic), TOPICS[topic].type_name, serialize(message), stamp_ns)


def message_of(topic: str, estimate: Estimate, p: SlipEstimatorParameters) -> Any:
    """The message that the live node publishes for an estimate on ``odometry`` or ``track_slip``."""
    if topic == ODOMETRY:
        return conversions.odometry(make, estimate, p.odom_frame, p.base_frame)
    return conversions.track_slip(make, estimate, p.base_frame)


def summary(result: Replay, elapsed_s: float) -> dict[str, Any]:
    """The contents of ``--json``; null where something could not be computed.

    ``elapsed_s`` is what the user waited for.
    """
    rmse: dict[str, float | None] = {}
    for name in _NAMES:
        found = result.scores.get(name)
        rmse[name] = found.position if found else None
    of_filter = result.scores.get("filter")
    rmse["heading"] = of_filter.heading if of_filter else None
    rmse["slip"] = result.slip_rmse
    content = {
        "vehicle": result.vehicle,
        "duration_s": result.duration_s,
        "messages": dict(sorted(result.messages.items())),
        "rejected": result.rejected.by_source(),
        "final": _final(result),
        "reference": result.reference,
        "rmse": rmse,
        "nees": result.nees,
        "real_time_factor": result.duration_s / elapsed_s,
    }
    if result.live is not None:
        content["replay_matches"] = result.live.matches
    if result.soil is not None:
        content["soil"] = soil_summary(result.soil)
    return content


def text(result: Replay, elapsed_s: float) -> str:
    """The summary as lines for a terminal; ``elapsed_s`` is what the user waited for."""
    speed = result.duration_s / elapsed_s
    lines = [f"{result.duration_s:.1f} s replayed in {elapsed_s:.1f} s ({speed:.0f} × real time)"]
    lines += [f"  {topic:<24}{n:>8} messages" for topic, n in sorted(result.messages.items())]
    for source, reasons in result.rejected.by_source().items():
        lines += [f"  {source:<24}{n:>8} not used: {reason}" for reason, n in reasons.items()]
    final = _final(result)
    if final is None:
        lines.append("no estimate: nothing to start from (no fix of a pose source, no initial pose)")
    else:
        lines.append("final  " + "  ".join(f"{name} {value:.4f}" for name, value in final.items()))
    lines += _scores(result)
    lines += _live(result)
    if result.soil is not None:
        lines += soil_lines(result.soil)
    return "\n".join(lines)


def _final(result: Replay) -> dict[str, float] | None:
    if not len(result.estimates):
        return None
    last = result.estimates[-1]
    x, y, yaw = last["pose"].tolist()
    left, right, _ = last["slips"].tolist()
    return {"x": x, "y": y, "yaw": yaw, "left_slip": left, "right_slip": right}


def _scores(result: Replay) -> list[str]:
    if result.reference is None:
        return ["no reference in the bag: nothing to score against (--reference TOPIC names one)"]
    lines = [f"RMSE against {result.reference}        position m   heading rad"]
    for name, label in _NAMES.items():
        found = result.scores.get(name)
        numbers = f"{found.position:>12.4f}{found.heading:>14.4f}" if found else f"{'–':>12}{'–':>14}"
        lines.append(f"  {label:<32}{numbers}")
    if result.slip_rmse is not None:
        lines.append(f"  slip RMSE {result.slip_rmse:.4f}")
    if result.nees is not None:
        lines.append(f"  mean NEES of pose {result.nees:.2f} (3 if consistent)")
    return lines


def _live(result: Replay) -> list[str]:
    live = result.live
    if live is None:
        return []
    lines = [str(live)]
    if live.lost_inputs:
        lines.append(f"  the bag lacks {live.lost_inputs} measurements that the live estimator took")
    if live.lost_reports:
        lines.append(f"  the bag lacks {live.lost_reports} lines of the live estimator's journal")
    return lines
