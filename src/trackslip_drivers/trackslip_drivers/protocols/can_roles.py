# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Reads the roles file, which assigns roles to the signals of a user's DBC. See ``docs/can.md``.

roles: {ROLE: {signal: FRAME.SIGNAL, …}, …}
frames: {FRAME: {counter: SIGNAL, checksum: SIGNAL, …}, …}
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from trackslip_common.config_files import read_yaml
from trackslip_common.errors import InputError
from trackslip_common.parameter_spec import Spec, convert_value
from trackslip_common.yaml_tree import check_keys, section
from trackslip_drivers.protocols.can_codec import CHECKSUMS, Protection
from trackslip_drivers.protocols.units import Quantity

POSITION, SPEED, FLOW = "position", "speed", "flow"
MOTIONS = (POSITION, SPEED, FLOW)  # of a sprocket: alternatives
SIDES = ("left", "right")
SWING, SUPPLY = "swing", "supply_pressure"

_POSITION_QUANTITIES = (Quantity.ANGLE, Quantity.COUNT)
_SIDE_QUANTITIES: Mapping[str, tuple[Quantity, ...]] = {
    POSITION: _POSITION_QUANTITIES,
    SPEED: (Quantity.ANGULAR_SPEED, Quantity.SPEED),
    FLOW: (Quantity.FLOW,),
    "pressure": (Quantity.PRESSURE,),
    "spool": (Quantity.RATIO, Quantity.PRESSURE),
}
ROLES: Mapping[str, tuple[Quantity, ...]] = {
    **{f"{side}_{what}": quantities for what, quantities in _SIDE_QUANTITIES.items() for side in SIDES},
    SUPPLY: (Quantity.PRESSURE,),
    SWING: _POSITION_QUANTITIES,
}
"""Name → what its signal may measure."""


class Role(NamedTuple):
    """One entry of the roles file; the fields are its keys."""

    signal: str
    minus: str = ""  # a second signal that is subtracted: port A minus port B
    unit: str = ""  # if the DBC has no known unit
    sign: int = 1
    ratio: float = 1.0  # sensor turns per sprocket turn, or measured speed per sprocket speed
    counts_per_turn: float = 0.0  # of the sensor, for counts
    wraps_at: float = 0.0  # in the signal's unit; 0: at the end of the DBC's range
    offset: float = 0.0  # reading at zero, in the signal's unit
    zero: str = ""  # pilot pressure of a closed spool, with its unit (or in the signal's)
    full: str = ""  # pilot pressure of a fully open spool
    source: int = -1  # J1939 address of the sender; -1: any


SPOOLS = tuple(f"{side}_spool" for side in SIDES)
_SPOOL_KEYS = ("zero", "full")
_POSITION_KEYS = ("counts_per_turn", "wraps_at")
_MOTION_KEYS = ("ratio",)
_NON_MOTION_QUANTITIES = (Quantity.PRESSURE, Quantity.RATIO)


class RolesFile(NamedTuple):
    """Contents of a roles file."""

    roles: Mapping[str, Role]
    protections: Mapping[str, Protection]  # by frame


def read_roles(path: Path) -> RolesFile:
    """Read a roles file; checks all that does not depend on the DBC.

    Raises:
        InputError: a role, key or value is not accepted, or roles are mutually exclusive.
    """
    tree = read_yaml(path)
    where = f"roles_file {path}"
    check_keys(where, tree, (), ("roles", "frames"), "section")
    entries, frames = (section(f"{where}: {name}", tree.get(name) or {}) for name in ("roles", "frames"))
    check_keys(where, entries, (), ROLES, "role")
    roles = {name: _parse_role(f"{where}: role '{name}'", name, entry) for name, entry in entries.items()}
    _check_sides(where, roles)
    protections = {
        name: _parse_protection(f"{where}: frame '{name}'", entry) for name, entry in frames.items()
    }
    return RolesFile(roles, protections)


def _check_sides(where: str, roles: Mapping[str, Role]) -> None:
    if not roles:
        raise InputError(f"{where}: no roles; accepted: {', '.join(ROLES)}")
    for what in _SIDE_QUANTITIES:
        left, right = (f"{side}_{what}" for side in SIDES)
        if (left in roles) != (right in roles):
            missing, there = (left, right) if right in roles else (right, left)
            raise InputError(f"{where}: role '{missing}' is missing beside '{there}'; accepted: both or none")
    motions = [f"left_{what}" for what in MOTIONS if f"left_{what}" in roles]
    if len(motions) > 1:
        names = ", ".join(f"'{name}'" for name in motions)
        raise InputError(
            f"{where}: roles {names} overlap: each is the sprocket's motion; accepted: one of them"
        )


def _parse_role(where: str, name: str, entry: Any) -> Role:
    if isinstance(entry, str):
        entry = {"signal": entry}
    entry = section(where, entry)
    if "signal" not in entry:
        raise InputError(f"{where}: 'signal' is missing; accepted: FRAME.SIGNAL of the DBC")
    is_position = ROLES[name] == _POSITION_QUANTITIES
    excluded_keys = (
        ()
        if is_position
        else _POSITION_KEYS + (_MOTION_KEYS if ROLES[name][0] in _NON_MOTION_QUANTITIES else ())
    )
    if name in SPOOLS:
        levels = {key: str(entry[key]) for key in _SPOOL_KEYS if isinstance(entry.get(key), (int, float))}
        entry = {**entry, **levels}
    else:
        excluded_keys += _SPOOL_KEYS
    check_keys(where, entry, (), [key for key in Role._fields if key not in excluded_keys])
    if is_position and "minus" in entry:
        raise InputError(
            f"{where}: minus: a position is one signal; accepted: 'minus' of pressures, speeds, flows"
        )
    role = Role(**_convert_values(where, entry, Role._field_defaults | {"signal": ""}))
    if role.sign not in (1, -1):
        raise InputError(f"{where}: sign: {role.sign} is out of range; accepted: 1 or -1")
    for key in ("ratio", *_POSITION_KEYS):
        if key in entry and not 0.0 < getattr(role, key) < 1e12:
            raise InputError(f"{where}: {key}: {getattr(role, key):g} is out of range; accepted: > 0")
    if "source" in entry and not 0 <= role.source <= 0xFF:
        raise InputError(f"{where}: source: {role.source} is out of range; accepted: 0 to 255")
    return role


def _parse_protection(where: str, entry: Any) -> Protection:
    entry = section(where, entry)
    check_keys(where, entry, (), Protection._fields)
    protection = Protection(**_convert_values(where, entry, Protection._field_defaults))
    if protection.checksum and protection.checksum_type not in CHECKSUMS:
        accepted = ", ".join(CHECKSUMS)
        raise InputError(
            f"{where}: checksum_type: '{protection.checksum_type}' is unknown; accepted: {accepted}"
        )
    return protection


def _convert_values(where: str, entry: Mapping[str, Any], defaults: Mapping[str, Any]) -> dict[str, Any]:
    """The values by key, each converted to the type of the key's default."""
    kinds = {key: type(defaults[key]) for key in entry}
    return {key: convert_value(f"{where}: {key}", entry[key], kinds[key], Spec("")) for key in entry}
