# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Input of the setup check: columns of each sensor, with the stated parameters applied.

Times are s on one clock. The stated mounting, sign and scale turn the gyro to axes of base_link. The places
of fixes are those of the sensor; its stated lever arm is a field of its own.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from trackslip_common.arrays import BoolArray, FloatArray, IntArray
from trackslip_estimation.slip.motion import MotionParameters
from trackslip_estimation.soil.pressure_watch import WatchParameters

ComplexArray = NDArray[np.complex128]
Array = TypeVar("Array", FloatArray, ComplexArray)

TRACKS = "sprockets"  # topic


class Machine(NamedTuple):
    """Stated geometry."""

    radius: float  # rolling radius, m
    tread: float  # m
    contact_length: float  # m


class Counts(NamedTuple):
    """Angle of one count of the sprocket encoders, rad; 0: no counts."""

    measured: float = 0.0  # by positions or speeds
    stated: float = 0.0


@dataclass(frozen=True)
class Tracks:
    """Columns of the sprockets."""

    t: FloatArray  # (n,) s, ascending
    speeds: FloatArray  # (n, 2) left, right, rad/s
    angles: FloatArray  # (n, 2) rad, continuous: positions, or the integral of the speeds


@dataclass(frozen=True)
class Gyro:
    """Columns of an inertial unit."""

    name: str  # topic
    t: FloatArray  # (n,) s, ascending
    rates: FloatArray  # (n, 3) rad/s; nan where an axis is unknown
    accelerations: FloatArray  # (n, 3) m/s²; nan where there are none
    is_above: bool = False  # on the upper structure, which swings
    sign: float = 1.0  # stated, and applied
    scale: float = 1.0  # stated, and applied
    mounting: tuple[float, float, float] = (0.0, 0.0, 0.0)  # roll, pitch, yaw, rad; stated, and applied

    def select(self, rows: BoolArray | IntArray) -> "Gyro":
        """The readings of these rows, by flags (n,) or indices."""
        return replace(self, t=self.t[rows], rates=self.rates[rows], accelerations=self.accelerations[rows])


@dataclass(frozen=True)
class Fixes:
    """A source of positions."""

    name: str
    t: FloatArray  # (n,) s, ascending
    places: FloatArray  # (n, 2) m, of the sensor
    stddevs: FloatArray  # (n,) m, of one axis
    lever: tuple[float, float] = (0.0, 0.0)  # m, forward and left, stated
    is_above: bool = False

    def select(self, rows: BoolArray | IntArray) -> "Fixes":
        """The fixes of these rows, by flags (n,) or indices."""
        return replace(self, t=self.t[rows], places=self.places[rows], stddevs=self.stddevs[rows])

    @property
    def noise(self) -> float:
        """Usual standard deviation of one axis, m."""
        return float(np.median(self.stddevs)) if len(self.stddevs) else 0.0

    @property
    def complex_lever(self) -> complex:
        """The stated lever arm, m."""
        return complex(*self.lever)

    @property
    def complex_places(self) -> ComplexArray:
        """(n,) places x + i y, m."""
        return np.asarray(self.places @ np.array((1.0, 1.0j)))

    @cached_property
    def centred_places(self) -> ComplexArray:
        """(n,) places about their mean, m."""
        z = self.complex_places
        return np.asarray(z - z.mean() if len(z) else z)


@dataclass(frozen=True)
class Compass:
    """Headings of a pose source, or of a pair of antennas."""

    name: str
    t: FloatArray  # (n,) s, ascending
    headings: FloatArray  # (n,) rad
    is_used: bool = True  # by the estimator; else evidence only
    of_poses: bool = True  # headings of a pose source; else of a topic of its own
    offset: float = 0.0  # rad, stated, and applied, as are the next two
    convention: str = "enu"
    sign: int = 1
    is_above: bool = False

    def select(self, rows: BoolArray | IntArray) -> "Compass":
        """The headings of these rows, by flags (n,) or indices."""
        return replace(self, t=self.t[rows], headings=self.headings[rows])


@dataclass(frozen=True)
class Pressures:
    """Columns of the differential pressures over the travel motors."""

    name: str
    t: FloatArray  # (n,) s, ascending
    values: FloatArray  # (n, 2) left, right, Pa
    limits: WatchParameters
    relief: float  # Pa, highest pressure over a motor
    motion: MotionParameters


Source = TypeVar("Source", Gyro, Fixes, Compass)


@dataclass(frozen=True)
class Log:
    """All columns of a drive."""

    machine: Machine
    tracks: Tracks
    gyros: tuple[Gyro, ...] = ()
    fixes: tuple[Fixes, ...] = ()
    compasses: tuple[Compass, ...] = ()
    swing: tuple[FloatArray, FloatArray] | None = None  # (n,) s and (n,) rad
    counts: Counts = Counts()
    pressures: Pressures | None = None
    per_stamp: dict[str, float] = field(default_factory=dict)  # topic → readings at each of its stamps
    arrival_delays: dict[str, float] = field(default_factory=dict)  # topic → median of arrival − stamp, s
    unusable: dict[str, int] = field(default_factory=dict)  # topic without a valid reading → readings

    def with_tracks(self, matrix: FloatArray) -> "Log":
        """The log with (2, 2) ``matrix`` applied to left and right."""
        tracks = self.tracks
        return replace(self, tracks=Tracks(tracks.t, tracks.speeds @ matrix.T, tracks.angles @ matrix.T))

    def with_gyro(self, gyro: Gyro) -> "Log":
        """The log with another version of one gyro."""
        return replace(self, gyros=tuple(gyro if g.name == gyro.name else g for g in self.gyros))

    def with_stamps(self, change: Callable[[str, FloatArray], FloatArray | None]) -> "Log":
        """The log with other stamps (n,) of gyros, fixes and headings, from topic and present ones, s.

        A source whose stamps become None is left out.
        """

        def changed(sources: tuple[Source, ...]) -> tuple[Source, ...]:
            stamps = [change(source.name, source.t) for source in sources]
            return tuple(replace(s, t=t) for s, t in zip(sources, stamps, strict=True) if t is not None)

        gyros, fixes, compasses = changed(self.gyros), changed(self.fixes), changed(self.compasses)
        return replace(self, gyros=gyros, fixes=fixes, compasses=compasses)


def group_of(topic: str) -> str:
    """Group of parameters of a topic, as ``sources.imu_data_raw``."""
    return f"sources.{topic.replace('/', '_')}"
