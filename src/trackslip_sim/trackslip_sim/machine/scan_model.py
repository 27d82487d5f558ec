# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Model of a laser scanner on the site that measures the box on the moving vehicle and the background.

β_i, t_i  angle of beam i in the laser frame; its time after the scan's stamp  rad, s
δ         angle between beams; the mirror turns once in T: t_i = i T δ/2π      rad
ρ_i       distance along the beam to the nearest of box, walls and posts       m
σ         Gaussian noise of one range before rounding to the resolution        m

Each beam uses the pose of the vehicle at the beam's time. Only x, y and yaw of the vehicle are used: the
box is vertical over base_link on slopes too, and as high as the scan plane.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.errors import InputError
from trackslip_common.parameters import Parameters, parameter
from trackslip_common.vehicle import Box

Poses = tuple[FloatArray, FloatArray, FloatArray]

BEAMS = 361
ANGLE_MIN = -np.pi / 2.0
ANGLE_INCREMENT = np.pi / 360.0
TURN_TIME = 0.040  # s, one turn of the mirror
TIME_INCREMENT = TURN_TIME * ANGLE_INCREMENT / (2.0 * np.pi)


@dataclass(frozen=True, kw_only=True)
class SiteParameters(Parameters):
    """Pose and noise of the laser, and the background; frame odom."""

    laser_x: float = parameter("laser in the frame odom, x", unit="m")
    laser_y: float = parameter("laser in the frame odom, y", unit="m")
    laser_yaw: float = parameter("direction of the laser's middle beam in odom", unit="rad")
    range_stddev: float = parameter("noise of one range before rounding", unit="m", ge=0.0)
    range_resolution: float = parameter("step to which ranges are rounded, 0 for none", unit="m", ge=0.0)
    range_max: float = parameter("farthest return", unit="m", gt=0.0)
    walls: tuple[float, ...] = parameter("four numbers per wall: x and y of both ends", unit="m")
    posts: tuple[float, ...] = parameter("three numbers per post or person: x, y, radius", unit="m")

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, numbers, size in (("walls", self.walls, 4), ("posts", self.posts, 3)):
            if len(numbers) % size:
                raise InputError(f"SiteParameters.{name}: {len(numbers)} numbers; accepted: {size} for each")


class SiteScanner:
    """The laser on its site: scans the vehicle's box in front of a fixed background."""

    def __init__(self, site: SiteParameters, box: Box, seed: int) -> None:
        self._site = site
        self._box = box
        self._random = np.random.default_rng(seed)
        self.angles: FloatArray = ANGLE_MIN + ANGLE_INCREMENT * np.arange(BEAMS, dtype=np.float64)
        self._times: FloatArray = TIME_INCREMENT * np.arange(BEAMS, dtype=np.float64)
        direction = site.laser_yaw + self.angles
        self._direction: FloatArray = np.column_stack([np.cos(direction), np.sin(direction)])
        self._background = self._background_ranges()

    def scan(self, stamp_s: float, pose_at: Callable[[FloatArray], Poses]) -> FloatArray:
        """Ranges (361,), m, counter-clockwise; +inf without return.

        ``stamp_s`` is the time of the first beam; ``pose_at`` gives x, y, yaw of base_link in odom (m, m,
        rad) at an array of times, s.
        """
        ranges = self.true_ranges(stamp_s, pose_at)
        ranges = ranges + self._site.range_stddev * self._random.standard_normal(BEAMS)
        if self._site.range_resolution > 0.0:
            ranges = np.round(ranges / self._site.range_resolution) * self._site.range_resolution
        return np.where(ranges <= self._site.range_max, ranges, np.inf)

    def true_ranges(self, stamp_s: float, pose_at: Callable[[FloatArray], Poses]) -> FloatArray:
        """Ranges (361,) without noise, rounding or limit, m."""
        box = self._box_ranges(*pose_at(stamp_s + self._times))
        return np.minimum(box, self._background)

    def _box_ranges(self, x: FloatArray, y: FloatArray, yaw: FloatArray) -> FloatArray:
        """Range of each beam to the box by the slab method in the frame of the box; +inf without a hit."""
        cos, sin = np.cos(yaw), np.sin(yaw)
        laser_x, laser_y = self._site.laser_x - x, self._site.laser_y - y
        ahead = cos * laser_x + sin * laser_y - self._box.x
        beside = -sin * laser_x + cos * laser_y - self._box.y
        u, v = self._direction.T
        near_x, far_x = _slab_distances(ahead, cos * u + sin * v, self._box.length / 2.0)
        near_y, far_y = _slab_distances(beside, -sin * u + cos * v, self._box.width / 2.0)
        near, far = np.maximum(near_x, near_y), np.minimum(far_x, far_y)
        return np.where((near <= far) & (near > 0.0), near, np.inf)

    def _background_ranges(self) -> FloatArray:
        """Nearest wall or post along each beam (361,), m."""
        ranges = np.full(BEAMS, np.inf)
        laser = np.array([self._site.laser_x, self._site.laser_y])
        for wall in np.reshape(self._site.walls, (-1, 2, 2)):
            ranges = np.minimum(ranges, _wall_ranges(wall - laser, self._direction))
        for x, y, radius in np.reshape(self._site.posts, (-1, 3)):
            ranges = np.minimum(ranges, _post_ranges(np.array([x, y]) - laser, radius, self._direction))
        return ranges


def _slab_distances(origin: FloatArray, direction: FloatArray, half: float) -> tuple[FloatArray, FloatArray]:
    """Distances at which a ray enters and leaves the strip |coordinate| < half."""
    with np.errstate(divide="ignore", invalid="ignore"):
        one, other = (-half - origin) / direction, (half - origin) / direction
    return np.fmin(one, other), np.fmax(one, other)


def _wall_ranges(ends: FloatArray, direction: FloatArray) -> FloatArray:
    """Distance along each beam (N, 2) to the segment between two points (2, 2), m; +inf without a hit."""
    along = ends[1] - ends[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        across = direction[:, 0] * along[1] - direction[:, 1] * along[0]
        distance = (ends[0, 0] * along[1] - ends[0, 1] * along[0]) / across
        share = (ends[0, 0] * direction[:, 1] - ends[0, 1] * direction[:, 0]) / across
    return np.where((distance > 0.0) & (share >= 0.0) & (share <= 1.0), distance, np.inf)


def _post_ranges(centre: FloatArray, radius: float, direction: FloatArray) -> FloatArray:
    """Distance along each beam (N, 2) to a circle, m; +inf without a hit."""
    middle = direction @ centre
    half_chord2 = radius**2 - (centre @ centre - middle**2)
    distance = middle - np.sqrt(np.maximum(half_chord2, 0.0))
    return np.where((half_chord2 >= 0.0) & (distance > 0.0), distance, np.inf)
