# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Messages with arbitrary numbers, on every topic of the slip and the soil estimator.

``make fuzz`` takes a hundred thousand of each topic, ``make test`` some, among valid messages of a
machine. No message raises. Published values are finite. Each rejection is counted with its reason and
changes nothing; the valid messages are used.
"""

import argparse
import math
import struct
import sys
from collections import Counter
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from rclpy.serialization import deserialize_message, serialize_message

from trackslip_common.arrays import FloatArray
from trackslip_common.layout import Layout
from trackslip_common.make import header
from trackslip_common.nodes.messages import fields_of, make, message_class, packed_topic
from trackslip_common.packed import PackedMessage
from trackslip_common.topics import LEFT_SPROCKET, MACHINE_STATE, RIGHT_SPROCKET, SWING_JOINT
from trackslip_estimation.nodes.estimator_health import estimator_health
from trackslip_estimation.nodes.soil_estimator import soil_health
from trackslip_estimation.slip import conversions
from trackslip_estimation.slip.estimator import Estimate, SlipEstimator
from trackslip_estimation.slip.local_odometry import LocalOdometry
from trackslip_estimation.slip.measurements import (
    SET_POSE,
    Fault,
    Outcome,
    PoseFix,
    Sprockets,
    YawRate,
)
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.slip.source_watch import SourceWatch
from trackslip_estimation.slip.sources import Rejection
from trackslip_estimation.soil import conversions as soil_conversions
from trackslip_estimation.soil.records import HYDRAULICS, Hydraulics, MachineState, PoseWithCovariance
from trackslip_estimation.soil.soil_estimator import SoilEstimator
from trackslip_estimation.soil.soil_parameters import load_soil_parameters

COUNT = 100_000  # messages per topic
_PERIOD_NS = 10_000_000  # between two valid samples
_CHECK_PERIODS = 1000  # between two checks of the health
_VALUES = np.array(
    (math.nan, math.inf, -math.inf, 0.0, -0.0, 1.0, -1.0, 1e-300, -1e-300, 5e-324, 1e300, -1e300, 1.7e308)
)
PARAMETERS: dict[str, Any] = {
    "vehicle": "pc05_cab",
    "pose_sources": ["box_pose", "gnss_pose"],
    "heading_sources": ["heading"],
    "odometry_sources": ["visual_odometry"],
    "slip_sources": ["slip_seed"],
    "velocity_sources": ["fix_velocity"],
    "sources.imu_data_raw.use_orientation": True,
    "sources.gnss_pose.use_altitude": True,
}


class Topic(NamedTuple):
    """Message type of a topic, and its conversion for an estimator."""

    type_name: str
    convert: Callable[[Any], Any]
    names: tuple[str, ...] = ()  # of joints
    packed: bool = True


class Findings(NamedTuple):
    """Results of the messages."""

    counts: Counter[str]  # by outcome
    faults: list[str]  # violations


class Mutator:
    """Messages of a topic with arbitrary numbers."""

    def __init__(self, topic: Topic, rng: np.random.Generator) -> None:
        joints = dict.fromkeys(("position", "velocity", "effort"), [0.0] * len(topic.names))
        fields = {"name": list(topic.names), **joints} if topic.names else {}
        self._kind = message_class(topic.type_name)
        blank = make(topic.type_name, header=header(make, 0, "base_link"), **fields)
        self._raw = bytes(serialize_message(blank))
        self._places, self._plain = list[int](), list[float]()  # of all float64
        numbers = Layout(fields_of, topic.type_name, self._raw).dtype.fields
        assert numbers is not None
        for name, (field, offset, *_) in numbers.items():
            if field.base == np.float64:
                values = _plain(name, field.itemsize // 8).tolist()
                self._plain += values
                self._places += [offset + 8 * k for k in range(len(values))]
        self._topic, self._rng, self._packed = topic, rng, packed_topic(self._kind)

    def mutate(self, stamp_ns: int) -> Any:
        """A mutated message, converted."""
        raw = bytearray(self._raw)
        if self._rng.random() < 0.02:
            stamp_ns = int(self._rng.integers(-(2**31), 2**31)) * 1_000_000_000
        struct.pack_into("<iI", raw, 4, *divmod(stamp_ns, 1_000_000_000))
        for at, value in zip(self._places, self._values(), strict=True):
            struct.pack_into("<d", raw, at, value)
        if self._topic.packed:
            return self._topic.convert(PackedMessage(bytes(raw), self._packed))
        return self._topic.convert(deserialize_message(bytes(raw), self._kind))

    def _values(self) -> list[float]:
        """Arbitrary numbers; in half of the messages all are plain except for up to three."""
        n = len(self._places)
        if self._rng.random() < 0.5:
            return _numbers(self._rng, n)
        values = self._plain.copy()
        changed = self._rng.choice(n, min(int(self._rng.integers(4)), n), replace=False)
        for at, value in zip(changed, _numbers(self._rng, len(changed)), strict=True):
            values[at] = value
        return values


def _plain(name: str, n: int) -> FloatArray:
    """(n,) numbers as of sensors: a rotation of 20°, a diagonal covariance, 0.1 elsewhere."""
    if name.endswith("covariance"):
        return np.eye(math.isqrt(n)).ravel() * 0.1
    return np.full(n, math.sqrt(0.97) if name.endswith(".w") else 0.1)


def _numbers(rng: np.random.Generator, n: int) -> list[float]:
    """``n`` numbers: plausible, of any size, or not finite."""
    largest = 308.0 if rng.random() < 0.3 else 6.0
    values = 10.0 ** rng.uniform(-largest, largest, n) * rng.choice((-1.0, 1.0), n)
    tame = rng.random(n) < rng.choice((0.0, 0.5, 0.95))
    values[tame] = np.abs(0.1 * rng.normal(size=int(tame.sum())))
    special = rng.random(n) < rng.choice((0.0, 0.0, 0.05, 0.5))
    values[special] = rng.choice(_VALUES, int(special.sum()))
    numbers: list[float] = values.tolist()
    return numbers


def slip_topics() -> dict[str, Topic]:
    """Topics of the slip estimator with all kinds of sources."""
    p = load_slip_parameters(PARAMETERS)
    pose = "geometry_msgs/msg/PoseWithCovarianceStamped"
    joints, imu = "sensor_msgs/msg/JointState", "sensor_msgs/msg/Imu"
    compass, gyro = p.compasses()["heading"], p.gyros()["imu/data_raw"]
    camera, receiver = p.odometries()["visual_odometry"], p.velocities()["fix_velocity"]
    sprockets = (LEFT_SPROCKET, RIGHT_SPROCKET)
    return {
        "sprockets": Topic(joints, lambda m: conversions.sprockets(m, "sprockets"), sprockets),
        "imu/data_raw": Topic(imu, lambda m: conversions.yaw_rate(m, "imu/data_raw", gyro)),
        "box_pose": Topic(pose, lambda m: conversions.pose_fix(m, "box_pose")),
        "gnss_pose": Topic(pose, lambda m: conversions.pose_fix(m, "gnss_pose")),
        SET_POSE: Topic(pose, lambda m: conversions.pose_fix(m, SET_POSE), packed=False),
        "slip_seed": Topic("trackslip_msgs/msg/TrackSlip", lambda m: conversions.slip_fix(m, "slip_seed")),
        "swing": Topic(joints, lambda m: conversions.swing_angle(m, "swing", 1e-4), (SWING_JOINT,)),
        "heading": Topic(imu, lambda m: conversions.heading_fix(m, "heading", compass), packed=False),
        "fix_velocity": Topic(
            "geometry_msgs/msg/TwistWithCovarianceStamped",
            lambda m: conversions.velocity_fix(m, "fix_velocity", receiver),
        ),
        "visual_odometry": Topic(
            "nav_msgs/msg/Odometry", lambda m: conversions.odometry_pose(m, "visual_odometry", camera)
        ),
    }


def soil_topics() -> dict[str, Topic]:
    """Topics of the soil estimator."""
    return {
        HYDRAULICS: Topic("trackslip_msgs/msg/TrackHydraulics", soil_conversions.hydraulics),
        MACHINE_STATE: Topic("trackslip_msgs/msg/MachineState", soil_conversions.machine_state),
    }


def fuzz_slip(count: int, seed: int = 0) -> Findings:
    """Process ``count`` messages of each slip topic, among valid ones of a machine at standstill."""
    rng, p = np.random.default_rng(seed), load_slip_parameters(PARAMETERS)
    estimator, watch, local = SlipEstimator(p), SourceWatch(p.timeouts_ns()), LocalOdometry()
    mutators = {name: Mutator(topic, rng) for name, topic in slip_topics().items()}
    counts, faults = Counter[str](), list[str]()
    origin, R = np.zeros(3), np.diag((1e-4, 1e-4, 1e-4))
    for k in range(1, count + 1):
        now_ns = k * _PERIOD_NS
        good: list[Any] = [
            Sprockets("sprockets", now_ns, 0.0, 0.0, (0.0, 0.0)),
            YawRate("imu/data_raw", now_ns, 0.0, 1e-4),
        ]
        if k % 10 == 0:
            good += [PoseFix(SET_POSE, now_ns, origin, R), PoseFix("box_pose", now_ns + 1, origin, R)]
        for measurement in good:
            report, estimate = estimator.process(measurement)
            watch.add(report)
            expected = (Outcome.ACCEPTED, Outcome.JUMPED, Outcome.WAITING)
            if not isinstance(measurement, YawRate) and report.outcome not in expected and estimator.started:
                faults.append(f"period {k}: a good measurement of {report.source} is {report.outcome.name}")
            _check_estimate(estimate, local, k, faults)
        for name, mutator in mutators.items():
            measurement = mutator.mutate(now_ns + int(rng.integers(2, _PERIOD_NS)))
            if isinstance(measurement, Rejection):
                counts[f"{name} {measurement.name}"] += 1
                continue
            before = _newest(estimator)
            report, estimate = estimator.process(measurement)
            watch.add(report)
            reason = report.fault or report.outcome
            counts[f"{name} {reason.name}"] += 1
            if (report.outcome is Outcome.INVALID) != isinstance(reason, Fault):
                faults.append(f"period {k}: a message on {name} is invalid without a reason")
            if report.outcome is Outcome.INVALID and _newest(estimator) != before:
                faults.append(f"period {k}: an invalid message on {name} changed the estimate")
            _check_estimate(estimate, local, k, faults)
        if k % _CHECK_PERIODS == 0:
            estimator_health(estimator, watch, 0.0, counts)
    if estimator.divergences:
        faults.append(f"the estimate diverged {estimator.divergences} times")
    return Findings(counts, faults)


def _newest(estimator: SlipEstimator) -> bytes:
    count = estimator.window.count
    return estimator.window.best[count - 1].tobytes() if estimator.started else b""


def _check_estimate(estimate: Estimate | None, local: LocalOdometry, period: int, faults: list[str]) -> None:
    """Add a fault for each message of the estimate that is not finite."""
    if estimate is None:
        return
    for message in (
        conversions.odometry(make, estimate, "map", "base_link"),
        conversions.odometry(make, local.estimate_in_odom(estimate), "odom", "base_link"),
        conversions.track_slip(make, estimate, "base_link"),
        conversions.machine_state(make, estimate, "map", "base_link"),
        conversions.attitude(make, estimate, "base_link"),
        conversions.swing(make, estimate, "base_link"),
    ):
        if not _is_finite(message):
            faults.append(f"period {period}: {type(message).__name__} is not finite")


def _is_finite(message: Any) -> bool:
    """Whether all float64 of a message are finite, except for an unknown reserve."""
    for name, text in message.get_fields_and_field_types().items():
        value = getattr(message, name)
        if "double" in text and not name.endswith("thrust_reserve") and not np.isfinite(value).all():
            return False
        if hasattr(value, "get_fields_and_field_types") and not _is_finite(value):
            return False
    return True


def fuzz_soil(count: int, seed: int = 0) -> Findings:
    """Process ``count`` messages of each soil estimator topic, among valid ones of a driving machine."""
    rng, p = np.random.default_rng(seed), load_soil_parameters({"vehicle": PARAMETERS["vehicle"]})
    estimator = SoilEstimator(p)
    mutators = [Mutator(topic, rng) for topic in soil_topics().values()]
    counts, faults, published = Counter[str](), list[str](), 0
    twist, C, P = np.array((0.3, 0.0, 0.0)), np.diag((1e-4, 1e-4, 1e-4)), np.diag((1e-2, 1e-2, 1e-3))
    slips = np.array((0.1, 0.1, 0.0))
    for k in range(1, count + 1):
        now_ns = k * _PERIOD_NS
        pose = PoseWithCovariance(np.array((3e-3 * k, 0.0, 0.0)), P)
        good = [
            Hydraulics(now_ns, 5e6, 5e6, 0.5, 0.5),
            MachineState(now_ns, twist, C, pose, slips, Motion.STRAIGHT, swing=0.0, swing_variance=1e-4),
        ]
        bad = [mutator.mutate(now_ns + int(rng.integers(1, _PERIOD_NS))) for mutator in mutators]
        for soil_input in (*good, *bad):
            outputs = estimator.advance(soil_input)
            published += len(outputs)
            for output in outputs:
                if not _is_finite(soil_conversions.message_of(make, output, "base_link")):
                    faults.append(f"period {k}: {type(output).__name__} is not finite")
        if k % _CHECK_PERIODS == 0:
            soil_health(estimator, 0.0, counts)
            if not published:
                faults.append(f"period {k}: nothing was published since the last check")
            published = 0
    for (source, reason), n in estimator.tally.total.items():
        counts[f"{source} {reason}"] += n
    return Findings(counts, faults)


def main() -> int:
    """Send random messages; return the exit code, 1 where anything was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "count", type=int, nargs="?", default=COUNT, help="of each topic (default: %(default)s)"
    )
    count = parser.parse_args().count
    found_any = False
    for name, fuzz in (("slip", fuzz_slip), ("soil", fuzz_soil)):
        findings = fuzz(count)
        what = ", ".join(f"{text} {n}" for text, n in sorted(findings.counts.items()))
        print(f"{name} estimator, {count} messages of each topic: {what}")
        print("\n".join(findings.faults[:20]) or "nothing found", flush=True)
        found_any |= bool(findings.faults)
    return 1 if found_any else 0


if __name__ == "__main__":
    sys.exit(main())
