# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the box localizer (values: ``config/site.yaml``, ``config/box_localizer.yaml``)."""

from dataclasses import dataclass

from trackslip_common.parameters import Parameters, parameter
from trackslip_common.vehicle_files import ParametersWithVehicle

NODE = "box_localizer"
DEFAULT_FILES = ("site.yaml", "box_localizer.yaml")


@dataclass(frozen=True, kw_only=True)
class BoxLocalizerParameters(Parameters):
    """Pose and noise of the laser, initial pose of the vehicle, and gates."""

    laser_x: float = parameter("position of the laser in map, x", unit="m")
    laser_y: float = parameter("position of the laser in map, y", unit="m")
    laser_yaw: float = parameter("direction of the laser's middle beam in map", unit="rad")
    range_stddev: float = parameter("noise of one range before rounding", unit="m", gt=0.0)
    range_resolution: float = parameter("step to which the laser rounds ranges", unit="m", ge=0.0)
    initial_x: float = parameter("initial position of base_link in map, x", unit="m")
    initial_y: float = parameter("initial position of base_link in map, y", unit="m")
    initial_yaw: float = parameter("initial heading; decides which side is the front", unit="rad")
    initial_reach: float = parameter("search radius about the initial position", unit="m", gt=0.0)
    minimum_beams: int = parameter("beams that must hit the box", ge=3)
    grazing_angle: float = parameter(
        "smallest view angle of a side that still makes one cluster", unit="rad", gt=0.0, lt=1.57
    )
    fit_probability: float = parameter("χ² probability above which a fit is rejected", gt=0.5, lt=1.0)
    good_fit: float = parameter("χ² probability up to which no better fit is sought", gt=0.0, lt=1.0)
    largest_misfit: float = parameter(
        "mean χ² per degree of freedom of the fits, beyond which the box is not as stated",
        gt=1.0,
    )
    seen_through: float = parameter("largest share of its beams that end behind a box", ge=0.0, lt=1.0)
    gate_distance: float = parameter(
        "distance from the prediction allowed right after a fix", unit="m", gt=0.0
    )
    gate_yaw: float = parameter("heading difference allowed right after a fix", unit="rad", gt=0.0, lt=0.785)
    yaw_spreads: float = parameter(
        "standard deviations of the predicted heading by which gate_yaw is widened", gt=0.0
    )
    ambiguity_gate: float = parameter(
        "heading innovation, in standard deviations, beyond which its variance is inflated", gt=0.0
    )
    top_speed: float = parameter("speed that widens gate_distance without fixes", unit="m/s", gt=0.0)
    top_yaw_rate: float = parameter(
        "standard deviation of the yaw rate; widens gate_yaw without fixes", unit="rad/s", gt=0.0
    )
    clearance: float = parameter(
        "distance about the machine without another object of the box's shape", unit="m", gt=0.0
    )
    confirmation_distance: float = parameter(
        "distance after which a moving candidate is the box", unit="m", gt=0.0
    )
    confirmation_difference: float = parameter(
        "largest difference between the distances of a candidate and of the odometry", unit="m", gt=0.0
    )
    proof_share: float = parameter(
        "addition to confirmation_difference, as share of the distance", ge=0.0, lt=1.0
    )
    ambiguity_time: float = parameter(
        "time after its last acceptance for which a candidate makes another one ambiguous", unit="s", gt=0.0
    )
    candidate_timeout: float = parameter(
        "time without detection after which a candidate is forgotten", unit="s", gt=0.0
    )
    coast_time: float = parameter(
        "correlation time of the velocities; beyond it the vehicle is predicted at standstill",
        unit="s",
        gt=0.0,
    )
    resume_time: float = parameter(
        "time within which a restarted localizer continues its last track", unit="s", ge=0.0
    )
    max_gap: float = parameter(
        "scans stamped further ahead than this must be confirmed", unit="s", gt=0.0, le=600.0
    )
    jump_confirmations: int = parameter("consecutive scans that confirm a stamp far ahead, or back", ge=2)


@dataclass(frozen=True, kw_only=True)
class BoxNodeParameters(BoxLocalizerParameters, ParametersWithVehicle):
    """Parameters of the localizer, of the vehicle with the box, and of the frame of the poses."""

    map_frame: str = parameter("site frame, in which the pose of the laser is given")
    track_file: str = parameter(
        "file that keeps the track of the box for a restart during a drive; empty: none"
    )
