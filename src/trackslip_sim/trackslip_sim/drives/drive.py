# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A random drive as the estimator is given it: counts of the encoders, a gyro, and fixes while in sight.

Fixes are drawn, not found in scans: their standard deviations grow with the distance as the box localizer's
do, and they come while the machine is before the laser and not too far away.
"""

from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.soils import load_soils
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import Measurement, PoseFix, Sprockets, YawRate
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.records import to_records
from trackslip_estimation.slip.window import Records
from trackslip_sim.drives.route import drive_at_random
from trackslip_sim.machine.drawn import DrawnMachine, draw_machine, interpolated
from trackslip_sim.parameters import load_emulator_parameters
from trackslip_sim.truth.ground import build_ground
from trackslip_sim.truth.settings import load_settings

SOILS = ("sand", "sandy_loam", "clayey_soil", "dry_clay")
_SPROCKETS, _GYRO, _SCANS = 100.0, 11.85, 4.8  # Hz
_GYRO_STDDEV, _BIAS_STDDEV = 0.005, 0.005  # rad/s; stated, and of the bias
_FARTHEST = 24.0  # m from the laser
_PER_METRE = np.array((0.0007, 0.0007, 0.0037))  # standard deviations of a fix over the distance
_START_NS = 10**9
_LEAD_IN = 0.5  # s before the first fix


class RandomDrive(NamedTuple):
    """One drive."""

    seed: int
    soil: str
    machine: DrawnMachine
    measurements: Records  # (n,) of ``MEASUREMENT``
    t: FloatArray  # (k,) s, of the truth
    poses: FloatArray  # (k, 3) true
    fix_times: FloatArray  # (m,) s

    def pose_at(self, stamps_ns: FloatArray) -> FloatArray:
        """(l, 3) true poses."""
        return interpolated((stamps_ns - _START_NS) * 1e-9, self.t, self.poses)


def random_drive(seed: int, p: SlipEstimatorParameters, duration: float = 600.0) -> RandomDrive:
    """The drive of a seed, which also chooses the soil; ``duration`` in s."""
    random, soils, settings = np.random.default_rng(seed), load_soils(), load_settings()
    soil, machine = SOILS[seed % len(SOILS)], draw_machine(random)
    setting = build_ground(soils[soil], (), soils), p.vehicle.whole(), settings
    angles, twists, poses = drive_at_random(machine, setting, duration, seed)
    t = settings.sample_period * np.arange(len(poses), dtype=np.float64)
    fixes, fix_times = _fixes(machine, t, poses, next(iter(p.poses())), random)
    given = [
        *_sprockets(t, angles, p.encoder_resolution),
        *_rates(machine, t, twists[:, 2], next(iter(p.gyros())), random),
        *fixes,
    ]
    records = to_records(given, SlipEstimator(p).sources)
    return RandomDrive(seed, soil, machine, records, t, poses, fix_times)


def _sprockets(t: FloatArray, angles: FloatArray, resolution: float) -> list[Measurement]:
    every = round(1.0 / _SPROCKETS / (t[1] - t[0]))
    counted = np.floor(angles[::every] / resolution) * resolution
    stamps = zip(t[::every].tolist(), counted.tolist(), strict=True)
    return [Sprockets("sprockets", _ns(at), 0.0, 0.0, (left, right)) for at, (left, right) in stamps]


def _rates(
    machine: DrawnMachine, t: FloatArray, rates: FloatArray, source: str, random: np.random.Generator
) -> list[Measurement]:
    times = np.arange(1.0 / _GYRO, t[-1], 1.0 / _GYRO)
    shown = machine.gyro_scale * np.interp(times, t, rates) + _BIAS_STDDEV * random.standard_normal()
    shown += machine.gyro_noise * _GYRO_STDDEV * random.standard_normal(len(times))
    return [
        YawRate(source, _ns(at), rate, _GYRO_STDDEV**2)
        for at, rate in zip(times.tolist(), shown.tolist(), strict=True)
    ]


def _fixes(
    machine: DrawnMachine, t: FloatArray, poses: FloatArray, source: str, random: np.random.Generator
) -> tuple[list[Measurement], FloatArray]:
    """Those in sight, and when they are stamped."""
    site = load_emulator_parameters({}).site
    stamps = np.arange(_LEAD_IN, t[-1], 1.0 / _SCANS)
    at = interpolated(stamps - machine.fix_delay, t, poses)
    from_laser = at[:, :2] - (site.laser_x, site.laser_y)
    ahead = from_laser @ (np.cos(site.laser_yaw), np.sin(site.laser_yaw))
    distances = np.hypot(*from_laser.T)
    seen = (ahead > 0.0) & (distances < _FARTHEST)
    true = distances[:, np.newaxis] * _PER_METRE
    measured = at + true * random.standard_normal(true.shape)
    stated = np.square(true) / machine.fix_variance
    found: list[Measurement] = [
        PoseFix(source, _ns(stamps[k]), measured[k], np.diag(stated[k])) for k in np.flatnonzero(seen)
    ]
    return found, stamps[seen]


def _ns(t: float) -> int:
    return _START_NS + round(t * 1e9)
