# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Calibrates the machine and its sensors from drives, and derives the node parameters."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from trackslip_common.config_files import node_defaults
from trackslip_estimation.setup_check.finding import Result
from trackslip_estimation.slip.parameters import NODE, SlipEstimatorParameters
from trackslip_estimation.slip.sources import group_name
from trackslip_tools.calibration import gyro, setup_results, standstill, timing, tracks
from trackslip_tools.calibration.finding import (
    Finding,
    empty_finding,
    empty_findings,
    make_finding,
    round_value,
)
from trackslip_tools.calibration.recording import Recording

_VEHICLE_NODES = (NODE, "soil_estimator", "box_localizer")
_DRIVERS = {"imu/data_raw": "watson_imu", "box_pose": "sick_pls"}  # topic → driver with ``time_offset``
_NO_FINDING = Finding("", None, None)
_MIN_EFFICIENCY_STDDEV = 0.02  # of κ, least standard deviation
_NEEDED = {  # series of a recording → findings without a value where no bag has it
    "gyro": (
        *("gyro_bias", "gyro_sign", "gyro_scale", "pose_delay", "heading_delay", "imu_roll", "imu_pitch"),
        *("gyro_delay", "asymmetry", "turning_efficiency", "effective_tread"),
    ),
    "poses": ("effective_rolling_radius", "rolling_radius", "common_slip"),
    "hydraulics": ("left_pressure_offset", "right_pressure_offset"),
}
_MISSING = {
    "gyro": "no gyro in the bags (--gyro names one)",
    "poses": "no fixes in the bags (--poses names them)",
    "hydraulics": "no hydraulics in the bags",
}


@dataclass(frozen=True)
class Calibration:
    """Findings and the parameters that follow from them."""

    findings: Mapping[str, Finding]
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # node → dotted name → value
    confirmed: tuple[str, ...] = ()  # findings whose interval contains the present value: no parameters


def calibrate(
    recordings: Sequence[Recording],
    p: SlipEstimatorParameters,
    sources: tuple[str, str],
    setups: Sequence[Result] = (),
    *,
    hard_ground: bool = False,
    everything: bool = False,
) -> Calibration:
    """Findings and parameters; ``sources``: topics of gyro and poses.

    ``hard_ground``: no slip on the straights. ``setups``: results of the setup check of the same bags;
    findings that contradict them have no value.

    ``everything``: a finding becomes a parameter even if its interval contains the present value.
    """
    headings = gyro.scale_and_delay(recordings)
    findings = {
        "gyro_bias": standstill.gyro_bias(recordings),
        "gyro_sign": _gyro_sign(headings["gyro_scale"], timing.gyro_sense(recordings)),
        **headings,
        **gyro.mounting_angles(recordings),
        "gyro_delay": timing.gyro_delay(recordings),
        **standstill.pressure_offsets(recordings),
    }
    sensor = _gyro_of(findings)
    distance = tracks.distance_per_radian(recordings, sensor)
    findings["effective_rolling_radius"] = distance
    findings["rolling_radius"] = _rolling_radius(distance, hard_ground=hard_ground)
    radius = findings["rolling_radius"].value or p.vehicle.kinematics.rolling_radius
    if not hard_ground:
        findings["common_slip"] = _common_slip(distance, radius)
    turns = tracks.turning_gain(recordings, sensor)
    tread = p.vehicle.kinematics.tread
    findings["asymmetry"] = tracks.asymmetry(recordings, sensor, turns.gain, radius)
    findings |= _turning_findings(turns.gain, findings["gyro_scale"], radius, tread)
    findings["tread"] = empty_finding(
        "turns show r κ/B only, and κ is not 1 on any ground: measure it with a tape", "m"
    )
    findings |= _findings_without_sensor(findings, recordings)
    findings = setup_results.remove_contradicted(findings, setups) | setup_results.combine_measured(setups)
    spread = turns.stddev * tread / radius
    confirmed = () if everything else _confirmed_names(findings, p, sources[0])
    new_findings = {name: _NO_FINDING if name in confirmed else finding for name, finding in findings.items()}
    return Calibration(findings, _node_parameters(new_findings, spread, p, sources), confirmed)


def _findings_without_sensor(
    findings: Mapping[str, Finding], recordings: Sequence[Recording]
) -> dict[str, Finding]:
    """Findings that need a sensor which no recording has; the reason names the sensor."""
    missing = [key for key in _NEEDED if not any(len(getattr(r, key).t) for r in recordings)]
    return {
        name: empty_finding(_MISSING[key], findings[name].unit)
        for key in missing
        for name in _NEEDED[key]
        if name in findings
    }


def _confirmed_names(
    findings: Mapping[str, Finding], p: SlipEstimatorParameters, gyro: str
) -> tuple[str, ...]:
    """Findings whose intervals contain the present parameter."""
    present = {
        "rolling_radius": p.vehicle.kinematics.rolling_radius,
        "turning_efficiency": p.turning.initial_efficiency,
    }
    if gyro in p.gyros():
        present |= {"gyro_sign": p.gyros()[gyro].sign, "gyro_scale": p.gyros()[gyro].scale}
    return tuple(name for name, value in present.items() if findings[name].contains(value))


def _gyro_of(findings: Mapping[str, Finding]) -> tracks.Gyro:
    """Scale (or only its sign, if the scale is not found) and bias."""
    scale = findings["gyro_scale"].value or findings["gyro_sign"].value or 1.0
    return tracks.Gyro(scale, findings["gyro_bias"].value or 0.0)


def _gyro_sign(scale: Finding, sense: Finding) -> Finding:
    """1, or −1 for a unit mounted upside down; from the headings, else from the tracks' sense of turn."""
    for finding in (scale, sense):
        if finding.interval is not None and not finding.contains(0.0):
            sign = math.copysign(1.0, finding.interval[0])
            return make_finding(sign, 0.0, "1", finding.basis)
    return empty_finding(sense.reason or "too uncertain", "1")


def _rolling_radius(distance: Finding, *, hard_ground: bool) -> Finding:
    if distance.interval is None:
        return empty_finding(distance.reason, "m")
    if hard_ground:
        return Finding("m", distance.value, distance.interval, f"{distance.basis}, no slip")
    least = f"at least {distance.interval[0]:.4f} m where the machine drives itself"
    return empty_finding(f"shows only as r (1 − i₀), {least}; --hard-ground states that nothing slipped", "m")


def _common_slip(distance: Finding, radius: float) -> Finding:
    """i₀, if the present rolling radius is right."""
    if distance.value is None:
        return empty_finding(distance.reason, "1")
    slip = 1.0 - distance.value / radius
    return make_finding(slip, distance.spread / radius, "1", f"if r is {radius:g} m")


def _turning_findings(gain: Finding, scale: Finding, radius: float, tread: float) -> dict[str, Finding]:
    """κ and B/κ, with the uncertainty of the gyro's scale."""
    units = {"turning_efficiency": "1", "effective_tread": "m"}
    if gain.value is None:
        return empty_findings(gain.reason, units)
    shares, basis = [gain.spread / abs(gain.value)], gain.basis
    if scale.value is None:
        basis += ", the scale of the gyro taken as 1"
    else:
        shares.append(scale.spread / abs(scale.value))
    share = math.hypot(*shares)
    if share >= 1.0:
        reason = f"the turns differ too much: r κ/B is {gain.value:.3f} ± {share * gain.value:.3f}"
        return empty_findings(reason, units)
    efficiency, effective = gain.value * tread / radius, radius / gain.value
    interval = (effective / (1.0 + share), effective / (1.0 - share))
    return {
        "turning_efficiency": make_finding(
            efficiency, share * efficiency, "1", f"{basis}; if B is {tread:g} m"
        ),
        "effective_tread": Finding("m", effective, interval, f"B/κ on this ground: {basis}"),
    }


def _node_parameters(
    findings: Mapping[str, Finding], spread: float, p: SlipEstimatorParameters, sources: tuple[str, str]
) -> dict[str, dict[str, Any]]:
    """Node → dotted name → value, of the findings that are node parameters."""
    parameters: dict[str, dict[str, Any]] = {}

    def add(node: str, name: str, value: Any) -> None:
        parameters.setdefault(node, {})[name] = value

    if findings["rolling_radius"].value is not None:
        for node in _VEHICLE_NODES:
            add(node, "vehicle.kinematics.rolling_radius", findings["rolling_radius"].rounded_value)
    if sources[0] in p.gyros():
        group = f"sources.{group_name(sources[0])}"
        if findings["gyro_sign"].value is not None:
            add(NODE, f"{group}.sign", round(findings["gyro_sign"].value))
        scale = findings["gyro_scale"].rounded_value
        if scale is not None:
            add(NODE, f"{group}.scale", abs(scale))
    efficiency = findings["turning_efficiency"]
    if efficiency.value is not None and 0.0 < efficiency.value <= 1.0:
        add(NODE, "turning.initial_efficiency", efficiency.rounded_value)
        stddev = max(spread, efficiency.spread, _MIN_EFFICIENCY_STDDEV)
        add(NODE, "turning.initial_efficiency_stddev", round_value(stddev, efficiency.decimals))
    for node, offset in _time_offsets(findings, sources).items():
        add(node, "time_offset", offset)
    return parameters


def _time_offsets(findings: Mapping[str, Finding], sources: tuple[str, str]) -> dict[str, float]:
    """Driver → ``time_offset`` that aligns its stamps with the sprockets'; only if the interval excludes 0.

    The delay is subtracted from the offset in ``config/``, with which the bags are assumed to be recorded.
    """
    offsets, delay = {}, 0.0
    for topic, key in zip(sources, ("gyro_delay", "pose_delay"), strict=True):
        finding, node = findings.get(key), _DRIVERS.get(topic)
        if finding is None or finding.value is None or finding.contains(0.0):
            continue
        delay += finding.value
        if node is not None:
            present = float(node_defaults(node, f"{node}.yaml")["time_offset"])
            offsets[node] = round_value(present - delay, finding.decimals)
    return offsets
