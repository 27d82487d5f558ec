# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What the box localizer needs to know (values: ``config/site.yaml``, ``config/box_localizer.yaml``)."""

from dataclasses import dataclass

from trackslip_common.parameters import Parameters, parameter
from trackslip_common.vehicle_files import WithVehicle

NODE = "box_localizer"
DEFAULT_FILES = ("site.yaml", "box_localizer.yaml")


@dataclass(frozen=True, kw_only=True)
class BoxLocalizerParameters(Parameters):
    """The laser's place and noise, where the vehicle starts, and what is refused."""

    laser_x: float = parameter("laser in the frame map, x", unit="m")
    laser_y: float = parameter("laser in the frame map, y", unit="m")
    laser_yaw: float = parameter("direction of the laser's middle beam in map", unit="rad")
    range_stddev: float = parameter("noise of one range before rounding", unit="m", gt=0.0)
    range_resolution: float = parameter("step to which the laser rounds ranges", unit="m", ge=0.0)
    initial_x: float = parameter("base_link in map at the start, x", unit="m")
    initial_y: float = parameter("base_link in map at the start, y", unit="m")
    initial_yaw: float = parameter("heading at the start; decides which side is the front", unit="rad")
    initial_reach: float = parameter("distance about the initial place that is searched", unit="m", gt=0.0)
    minimum_beams: int = parameter("beams that must hit the box", ge=3)
    grazing_angle: float = parameter(
        "flattest view of a side that still makes one cluster", unit="rad", gt=0.0, lt=1.57
    )
    fit_probability: float = parameter("χ² probability above which a fit is refused", gt=0.5, lt=1.0)
    good_fit: float = parameter("χ² probability up to which no better fit is sought", gt=0.0, lt=1.0)
    seen_through: float = parameter("share of its beams that may go on behind a box", ge=0.0, lt=1.0)
    gate_distance: float = parameter("distance from the prediction allowed at once", unit="m", gt=0.0)
    gate_yaw: float = parameter("heading difference allowed at once", unit="rad", gt=0.0, lt=0.785)
    yaw_spreads: float = parameter(
        "standard deviations of the heading predicted by which gate_yaw is widened", gt=0.0
    )
    ambiguity_gate: float = parameter(
        "standard deviations between prediction and fix, beyond which its heading is uncertain", gt=0.0
    )
    top_speed: float = parameter("widens gate_distance while no fix comes", unit="m/s", gt=0.0)
    top_yaw_rate: float = parameter(
        "standard deviation of the yaw rate; widens gate_yaw while no fix comes", unit="rad/s", gt=0.0
    )
    clearance: float = parameter(
        "distance about the machine within which nothing else looks like the box", unit="m", gt=0.0
    )
    proof_distance: float = parameter(
        "what may be the box is it once it has driven this far", unit="m", gt=0.0
    )
    proof_difference: float = parameter(
        "by which the way of what may be the box may differ from the odometry's", unit="m", gt=0.0
    )
    proof_share: float = parameter("and share of the way by which it may besides", ge=0.0, lt=1.0)
    rival_time: float = parameter(
        "for which what may be the box, seen no more, makes another thing uncertain", unit="s", gt=0.0
    )
    forgotten_time: float = parameter(
        "without being seen, after which what may be the box is forgotten", unit="s", gt=0.0
    )
    coast_time: float = parameter(
        "time for which velocities last, beyond which the vehicle is sought where it was", unit="s", gt=0.0
    )
    resume_time: float = parameter(
        "time within which a localizer started again seeks the box about its last track", unit="s", ge=0.0
    )
    max_gap: float = parameter("scans stamped further ahead must be confirmed", unit="s", gt=0.0, le=600.0)
    jump_confirmations: int = parameter("scans in a row that confirm a stamp far ahead, or back", ge=2)


@dataclass(frozen=True, kw_only=True)
class BoxNodeParameters(BoxLocalizerParameters, WithVehicle):
    """The localizer's, with the vehicle that carries the box and the frame of its poses."""

    map_frame: str = parameter("site frame, in which the laser's place is given")
    track_file: str = parameter("keeps the track of the box for a restart during a drive; empty: nothing")
