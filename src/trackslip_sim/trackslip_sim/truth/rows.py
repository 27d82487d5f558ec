# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Rows of numbers that every truth mode computes, and the ``Truth`` made from them."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.vehicle import Vehicle
from trackslip_estimation.terramechanics.hydraulics import pressure_of_thrust
from trackslip_sim.truth.record import Truth
from trackslip_sim.truth.settings import TruthSettings


class Column(IntEnum):
    """Columns of the rows; columns of two tracks are adjacent, left before right."""

    X = 0
    Y = 1
    YAW = 2
    V_X = 3
    V_Y = 4
    YAW_RATE = 5
    TRACK_SPEED = 6  # r ω, m/s
    ANGLE = 8  # of the sprockets, rad
    THRUST = 10  # N
    RESISTANCE = 12  # N, sign of v_j
    MOMENT = 14  # of lateral shear about C, N m, positive clockwise
    SPOOL = 15
    SOIL = 17  # index under C
    POWER = 18  # from the tracks to hull and soil, W
    LOSS = 19  # of shear and rolling, W
    ITERATIONS = 20  # of the solver, the maximum since the previous row
    DRIVE = 21  # thrust of the motors, N: soil thrust plus acceleration of the track itself
    Z = 23
    ROLL = 24
    PITCH = 25
    ROLL_RATE = 26  # p
    PITCH_RATE = 27  # q
    LOAD = 28  # on each track, N
    SIDE = 30  # force of lateral shear on the hull, N


WIDTH = 31


class UnsolvedStepError(ArithmeticError):
    """The solver did not balance the forces of a step: a defect of the solver, not of the input."""


def require_solved(rows: FloatArray, limit: int) -> None:
    """Check that each step of ``rows`` (n, WIDTH) took fewer iterations than ``limit``.

    Raises:
        UnsolvedStepError: a step took ``limit`` iterations.
    """
    unsolved = np.flatnonzero(rows[:, Column.ITERATIONS] >= limit)
    if unsolved.size:
        raise UnsolvedStepError(
            f"{unsolved.size} of {len(rows)} samples unsolved, the first is {unsolved[0]}"
        )


@dataclass(frozen=True)
class Recorder:
    """Converts the rows of a run to records."""

    vehicle: Vehicle
    settings: TruthSettings
    relief_pressure: float  # Pa
    soil_names: tuple[str, ...]

    def truth(self, rows: FloatArray, first: int = 0, swing: FloatArray | None = None) -> Truth:
        """The record of rows (n, WIDTH), one each ``settings.sample_period``; the first is number ``first``.

        ``swing`` (n, 2): angle and rate of the upper structure; None: both are 0.

        Pressures follow from the motors' thrust; the efficiency acts against the flow of power. The supply
        pressure is the higher of them plus the standby pressure, limited by the relief valve.
        """
        rows = np.asfortranarray(rows)  # contiguous columns: interpolation would copy them otherwise
        c, vehicle, settings, relief = Column, self.vehicle, self.settings, self.relief_pressure
        v_x, yaw_rate = rows[:, c.V_X], rows[:, c.YAW_RATE]
        left, right = rows[:, c.TRACK_SPEED], rows[:, c.TRACK_SPEED + 1]
        floor, half = settings.slip_floor, 0.5 * vehicle.tread
        swing = np.zeros((len(rows), 2)) if swing is None else swing
        # The clip acts only in steps in which a track reverses: the thrust limit is that of the step's start.
        left_pressure, right_pressure = (
            np.clip(pressure_of_thrust(rows[:, c.DRIVE + k], track, vehicle), -relief, relief)
            for k, track in enumerate((left, right))
        )
        higher = np.maximum(np.abs(left_pressure), np.abs(right_pressure))
        return Truth(
            t=np.arange(first, first + len(rows), dtype=np.float64) * settings.sample_period,
            x=rows[:, c.X],
            y=rows[:, c.Y],
            z=rows[:, c.Z],
            yaw=rows[:, c.YAW],
            pitch=rows[:, c.PITCH],
            roll=rows[:, c.ROLL],
            v_x=v_x,
            v_y=rows[:, c.V_Y],
            roll_rate=rows[:, c.ROLL_RATE],
            pitch_rate=rows[:, c.PITCH_RATE],
            yaw_rate=yaw_rate,
            left_angle=rows[:, c.ANGLE],
            right_angle=rows[:, c.ANGLE + 1],
            left_speed=left / vehicle.rolling_radius,
            right_speed=right / vehicle.rolling_radius,
            left_slip=_slip(v_x - half * yaw_rate, left, floor),
            right_slip=_slip(v_x + half * yaw_rate, right, floor),
            slip_angle=np.arctan(_ratio(rows[:, c.V_Y], v_x, floor)),
            left_thrust=rows[:, c.THRUST],
            right_thrust=rows[:, c.THRUST + 1],
            left_resistance=rows[:, c.RESISTANCE],
            right_resistance=rows[:, c.RESISTANCE + 1],
            left_load=rows[:, c.LOAD],
            right_load=rows[:, c.LOAD + 1],
            turning_moment=rows[:, c.MOMENT] * np.sign(yaw_rate),
            left_pressure=left_pressure,
            right_pressure=right_pressure,
            left_spool=rows[:, c.SPOOL],
            right_spool=rows[:, c.SPOOL + 1],
            supply_pressure=np.minimum(higher + settings.standby_pressure, relief),
            swing=swing[:, 0],
            swing_rate=swing[:, 1],
            soil_index=rows[:, c.SOIL].astype(np.int64),
            soil_names=self.soil_names,
        )


def _slip(ground_speed: FloatArray, track_speed: FloatArray, floor: float) -> FloatArray:
    """i = 1 - v/(r ω); 0 where |r ω| < ``floor``."""
    return _ratio(track_speed - ground_speed, track_speed, floor)


def _ratio(numerator: FloatArray, denominator: FloatArray, floor: float) -> FloatArray:
    """Quotient, 0 where |denominator| < ``floor``."""
    defined = np.abs(denominator) >= floor
    quotient: FloatArray = np.divide(numerator, denominator, out=np.zeros_like(numerator), where=defined)
    return quotient
