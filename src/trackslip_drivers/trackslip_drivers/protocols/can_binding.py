# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Binds roles to the signals of a DBC: conversion to SI, and the wrap of positions.

ω = 2π η_V Q/(V_m n_g)      sprocket whose motor receives the flow Q
ω = v/r                     sprocket of a track with speed v
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from cantools.database import Message

from trackslip_common.errors import InputError
from trackslip_common.vehicle import VehicleParameters
from trackslip_drivers.protocols.can_codec import Field, field_of
from trackslip_drivers.protocols.can_dbc import Dbc
from trackslip_drivers.protocols.can_roles import ROLES, SPOOLS, SWING, Role
from trackslip_drivers.protocols.units import UNITS, Quantity, Unit, accepted_units

_TURN = 2.0 * math.pi
_MOST_BITS = 64  # of a signal with a role
_LARGEST_STEP = 1.000001 * _TURN  # of a position: one turn (a counter of turns)
_ROUNDED_FACTOR = 0.01  # relative error of a rounded DBC factor: 65536 steps of 0.0055 degrees are 360.4
_ROUNDING_STEPS = 2.0  # tolerance of a range against whole turns: 0…359.9 or −180…180 degrees is one turn


class SignalId(NamedTuple):
    """A signal of a frame, from the sender with address ``source`` or from any (−1)."""

    frame: str
    signal: str
    source: int


class ScaledSignal(NamedTuple):
    """A signal that is scaled to SI: (value − offset) × factor, clamped to [low, high]."""

    signal_id: SignalId
    offset: float
    factor: float
    low: float = -math.inf
    high: float = math.inf

    def si_value(self, value: float) -> float:
        """The SI value of a value in the DBC's unit; nan for nan."""
        return min(max((value - self.offset) * self.factor, self.low), self.high)


class PositionSignal(NamedTuple):
    """A position, decoded from raw steps; positive: drives forward, or counter-clockwise (swing)."""

    signal_id: SignalId
    rad_per_step: float
    steps_per_wrap: float  # until the position repeats; a whole number where possible
    zero_steps: float  # raw reading at angle zero


class Bindings(NamedTuple):
    """The bound signals of all roles; a value with several parts is the sum of the parts."""

    scaled_signals: Mapping[str, tuple[ScaledSignal, ...]]
    position_signals: Mapping[str, PositionSignal]

    def signal_ids(self) -> list[SignalId]:
        """Every signal in use."""
        scaled = [part.signal_id for parts in self.scaled_signals.values() for part in parts]
        return [*scaled, *(position.signal_id for position in self.position_signals.values())]


class Binder:
    """Finds the signals of the roles in a DBC.

    Args:
        dbc: the parsed DBC.
        vehicle: converts flows and ground speeds to sprocket speeds.
        dbc_path, roles_path: of the files, for error messages.
    """

    def __init__(self, dbc: Dbc, vehicle: VehicleParameters, dbc_path: Path, roles_path: Path) -> None:
        self._database = dbc.database
        self._left_out = dbc.left_out
        self._vehicle = vehicle
        self._dbc_path = dbc_path
        self._roles_path = roles_path

    def bind(self, roles: Mapping[str, Role]) -> Bindings:
        """The bindings of all roles.

        Raises:
            InputError: a signal is missing or ambiguous; its unit is unknown, missing or of another quantity;
                or two roles share a signal.
        """
        scaled: dict[str, tuple[ScaledSignal, ...]] = {}
        positions: dict[str, PositionSignal] = {}
        users: list[tuple[SignalId, str]] = []
        for name, role in roles.items():
            if Quantity.COUNT in ROLES[name]:
                positions[name] = self._bind_position(name, role)
                signal_ids = [positions[name].signal_id]
            else:
                signals = ((role.signal, 1.0), (role.minus, -1.0)) if role.minus else ((role.signal, 1.0),)
                scaled[name] = tuple(self._bind_scaled(name, role, *signal) for signal in signals)
                signal_ids = [part.signal_id for part in scaled[name]]
            for signal_id in signal_ids:
                self._check_unused(signal_id, name, users)
                users.append((signal_id, name))
        return Bindings(scaled, positions)

    def _check_unused(self, signal_id: SignalId, name: str, users: list[tuple[SignalId, str]]) -> None:
        """Raise ``InputError`` if a signal has another role."""
        for other, user in users:
            has_other_source = -1 not in (other.source, signal_id.source) and other.source != signal_id.source
            if other[:2] != signal_id[:2] or has_other_source:
                continue
            roles = f"role '{name}'" if user == name else f"roles '{user}' and '{name}'"
            signal = f"signal '{signal_id.frame}.{signal_id.signal}' is used twice"
            raise InputError(f"roles_file {self._roles_path}: {roles}: {signal}; accepted: a signal for each")

    def _bind_scaled(self, name: str, role: Role, reference: str, weight: float) -> ScaledSignal:
        where, message, signal = self._find_signal(name, reference)
        unit = self._unit(where, name, role, message.get_signal_by_name(signal).unit)
        if unit.quantity is Quantity.PRESSURE and name in SPOOLS:
            return self._scale_spool(where, self._signal_id(where, message, signal, role), role, weight, unit)
        if role.zero or role.full:
            raise InputError(
                f"{where}: zero and full are for pilot pressures; accepted: none, as it is a ratio"
            )
        factor = unit.factor * role.sign * weight
        if unit.quantity is Quantity.FLOW:
            v = self._vehicle.hydraulics
            if v is None:
                fault = f"vehicle '{self._vehicle.name}' has no hydraulics"
                raise InputError(f"{where}: flow: {fault}; accepted: one with them")
            factor *= _TURN * v.volumetric_efficiency / (v.motor_displacement * v.gear_ratio)
        elif unit.quantity is Quantity.SPEED:
            factor /= self._vehicle.kinematics.rolling_radius
        return ScaledSignal(self._signal_id(where, message, signal, role), role.offset, factor / role.ratio)

    @staticmethod
    def _scale_spool(where: str, signal_id: SignalId, role: Role, weight: float, unit: Unit) -> ScaledSignal:
        """Scale a pilot pressure to a spool position: 0 up to ``zero``, ±1 from ``full`` on."""
        zero, full = (
            _parse_pressure(f"{where}: {key}", getattr(role, key), unit) for key in ("zero", "full")
        )
        if full <= zero:
            raise InputError(f"{where}: full: {role.full} is not above zero ({role.zero}); accepted: more")
        sign = role.sign * weight
        return ScaledSignal(signal_id, zero, sign / (full - zero), min(sign, 0.0), max(sign, 0.0))

    def _bind_position(self, name: str, role: Role) -> PositionSignal:
        where, message, signal = self._find_signal(name, role.signal)
        field = field_of(message, signal)
        unit = self._unit(where, name, role, message.get_signal_by_name(signal).unit)
        rad = unit.factor
        if unit.quantity is Quantity.COUNT:
            if not role.counts_per_turn:
                raise InputError(
                    f"{where}: counts_per_turn is missing; accepted: counts of the sensor in one turn"
                )
            rad = _TURN / role.counts_per_turn
        elif role.counts_per_turn:
            raise InputError(f"{where}: counts_per_turn is for counts; accepted: none, as it is an angle")
        step, zero = (1.0, 0.0) if field.floating else (field.scale, field.offset)
        if rad * abs(step) / role.ratio > _LARGEST_STEP:
            raise InputError(f"{where}: its factor makes a step of more than a turn; accepted: smaller steps")
        wrap = role.wraps_at / abs(step) if role.wraps_at else _steps_per_wrap(field, step, rad)
        if name == SWING and unit.quantity is Quantity.ANGLE and role.ratio == 1.0 and not role.wraps_at:
            wrap = _steps_per_turn(wrap, abs(step), rad)
        return PositionSignal(
            self._signal_id(where, message, signal, role),
            rad * step * role.sign / role.ratio,
            _round_if_whole(wrap),
            (role.offset - zero) / step,
        )

    def _find_signal(self, name: str, reference: str) -> tuple[str, Message, str]:
        """(prefix of messages, frame, signal) for FRAME.SIGNAL, or for a signal name that one frame has."""
        where = f"roles_file {self._roles_path}: role '{name}': signal '{reference}'"
        frame, _, signal = reference.rpartition(".")
        frames = [
            message
            for message in self._database.messages
            if frame in ("", message.name) and any(s.name == signal for s in message.signals)
        ]
        if not frames:
            unreadable = "".join(f" (frame '{n}' there: {reason})" for n, reason in self._left_out.items())
            raise InputError(
                f"{where} is missing in {self._dbc_path}{unreadable}; accepted: FRAME.SIGNAL of the DBC"
            )
        if len(frames) > 1:
            names = ", ".join(f"{message.name}.{signal}" for message in frames)
            raise InputError(f"{where} is in several frames; accepted: one of {names}")
        bits = frames[0].get_signal_by_name(signal).length
        if bits > _MOST_BITS:
            raise InputError(f"{where} has {bits} bits in {self._dbc_path}; accepted: up to {_MOST_BITS}")
        if not frames[0].get_signal_by_name(signal).scale:
            raise InputError(f"{where} has the factor 0 in {self._dbc_path}; accepted: any other")
        return where, frames[0], signal

    @staticmethod
    def _signal_id(where: str, message: Message, signal: str, role: Role) -> SignalId:
        if role.source >= 0 and message.protocol != "j1939":
            raise InputError(f"{where}: source: frame '{message.name}' is none of J1939; accepted: none")
        return SignalId(message.name, signal, role.source)

    @staticmethod
    def _unit(where: str, name: str, role: Role, dbc_unit: str | None) -> Unit:
        """The DBC's unit; the unit of the roles file if the DBC's is empty or unknown."""
        text = (dbc_unit or "").strip()
        accepted = accepted_units(ROLES[name])
        of_dbc, of_roles = UNITS.get(text), UNITS.get(role.unit.strip())
        if role.unit and of_roles is None:
            raise InputError(f"{where}: unit: '{role.unit}' is unknown; accepted: {accepted}")
        if of_dbc and of_roles and of_dbc != of_roles:
            raise InputError(
                f"{where}: unit: '{role.unit}', but the DBC has '{text}'; accepted: one unit, there or here"
            )
        unit = of_dbc or of_roles
        if unit is None:
            what = f"unit '{text}' of the DBC is unknown" if text else "the DBC has no unit"
            raise InputError(f"{where}: {what}; accepted: unit: one of {accepted}")
        if unit.quantity not in ROLES[name]:
            raise InputError(
                f"{where}: '{text or role.unit}' is a unit of {unit.quantity.value}; accepted: {accepted}"
            )
        return unit


def _parse_pressure(where: str, text: str, unit: Unit) -> float:
    """A pressure of the roles file, converted to the signal's unit."""
    number, _, name = text.strip().partition(" ")
    stated = UNITS.get(name.strip()) if name else unit
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or stated is None or stated.quantity is not Quantity.PRESSURE:
        units = accepted_units((Quantity.PRESSURE,))
        raise InputError(f"{where}: '{text}' is no pressure; accepted: as 0.5 MPa, in {units}")
    return value * stated.factor / unit.factor


def _steps_per_wrap(field: Field, step: float, rad: float) -> float:
    """Raw steps until a position repeats: the DBC's range, rounded to whole turns if it is close to them."""
    full_range = field.mask + 1.0
    if field.floating or math.isinf(field.low) or math.isinf(field.high):
        span = _TURN / rad if field.floating else full_range
    else:
        span = min((field.high - field.low) / abs(step) + 1.0, full_range)
    turn = _TURN / (rad * abs(step))
    turns = round(span / turn)
    return turns * turn if turns and abs(span - turns * turn) <= _ROUNDING_STEPS else span


def _steps_per_turn(wrap: float, step: float, rad: float) -> float:
    """Raw steps of one turn: a swing is taken modulo one turn, as no cab swings half a turn between frames.

    If ``wrap`` differs from one turn only by a rounded factor, ``wrap`` is returned.
    """
    turn = _TURN / (rad * step)
    return wrap if abs(wrap - turn) <= _ROUNDED_FACTOR * turn else turn


def _round_if_whole(steps: float) -> float:
    """The steps, rounded if they differ from a whole number only by rounding: whole numbers are exact."""
    return round(steps) if abs(steps - round(steps)) < 1e-6 * max(steps, 1.0) else steps
