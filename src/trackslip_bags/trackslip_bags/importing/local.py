# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Positions on the Earth as east and north of a datum (WGS84), with the checks of the GNSS localizer."""

import math
from collections.abc import Mapping

import numpy as np

from trackslip_bags.importing.samples import SelectedRows
from trackslip_common.arrays import BoolArray, FloatArray
from trackslip_common.config_files import load_parameters
from trackslip_common.errors import InputError
from trackslip_estimation.gnss.localizer import Datum, Reason, east_north_up, too_far_reason
from trackslip_estimation.gnss.parameters import NODE, GnssLocalizerParameters

_MAX_TRIED = 100  # positions that are tried as a datum


class LocalFrame:
    """East and north of a datum: the given one, or the first position within reach of at least half of all.

    The first position of a log may be an outlier, which must not become the origin of the map.
    """

    def __init__(self, datum: Datum | None) -> None:
        self.datum = datum
        self.is_used = False
        limits = load_parameters(GnssLocalizerParameters, NODE, (f"{NODE}.yaml",))
        self._reach = limits.max_distance

    def reject(self, chosen: SelectedRows, columns: Mapping[str, FloatArray], where: str) -> None:
        """Leave out the chosen positions, one or more, that are none or off the map.

        ``where`` begins an error's message.

        Raises:
            InputError: all of them are to be left out.
        """
        place, among = place_of(columns), chosen.rows.copy()
        is_none: BoolArray = (np.abs(place[:, 0]) > math.pi / 2.0) | (np.abs(place[:, 1]) > math.pi)
        reasons = {Reason.OUT_OF_RANGE: among & is_none, Reason.NOT_A_NUMBER: among & np.isinf(place[:, 2])}
        good = among & ~(reasons[Reason.OUT_OF_RANGE] | reasons[Reason.NOT_A_NUMBER])
        if good.any():
            datum = self._datum_of(place[good], where)
            far = np.zeros(len(place), np.bool_)
            far[good] = self._is_out_of_reach(datum, place[good])
            far_reasons = [too_far_reason(datum, *degrees) for degrees in np.degrees(place[far, :2]).tolist()]
            for reason in (Reason.HEMISPHERE, Reason.FAR):
                rows = far.copy()
                rows[far] = [one is reason for one in far_reasons]
                reasons[reason] = rows
        if np.logical_or.reduce(list(reasons.values()))[among].all():
            raise InputError(self._all_rejected_text(place, int(among.argmax()), where, reasons))
        for reason, rows in reasons.items():
            chosen.reject(rows, reason.value)

    def with_east_north(self, columns: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        """Columns with ``x`` and ``y``, m, of positions that ``reject`` keeps; others as they are."""
        if "latitude" not in columns:
            return dict(columns)
        place = place_of(columns)
        x, y = _east_north(self._datum_of(place, ""), place).T
        self.is_used = True
        return {**columns, "x": x, "y": y}

    def _datum_of(self, place: FloatArray, where: str) -> Datum:
        """The datum; where none is given, the first position within reach of at least half of all."""
        remaining = np.arange(len(place)) if self.datum is None else np.arange(0)
        for _ in range(_MAX_TRIED):
            if self.datum is not None or not remaining.size:
                break
            latitude, longitude, altitude = place[remaining[0]].tolist()
            altitude = altitude if math.isfinite(altitude) else 0.0
            candidate = Datum(math.degrees(latitude), math.degrees(longitude), altitude)
            far = self._is_out_of_reach(candidate, place)
            self.datum = candidate if 2 * int(far.sum()) <= len(place) else None
            remaining = remaining[far[remaining]]
        if self.datum is None:
            text = f"no position has half of the {len(place)} within {self._reach / 1e3:g} km"
            raise InputError(f"{where}: {text}; accepted: datum: {{latitude: …, longitude: …}}")
        return self.datum

    def _is_out_of_reach(self, datum: Datum, place: FloatArray) -> BoolArray:
        """(n,) whether positions are beyond the map."""
        far: BoolArray = np.hypot(*_east_north(datum, place).T) > self._reach
        return far

    def _all_rejected_text(
        self, place: FloatArray, first: int, where: str, reasons: dict[Reason, BoolArray]
    ) -> str:
        """Message with the first checked position and the datum."""
        reason = next(reason for reason, rows in reasons.items() if rows[first])
        latitude, longitude = np.degrees(place[first, :2]).tolist()
        datum = "" if self.datum is None else f" ({self.datum.latitude:.6f}, {self.datum.longitude:.6f})"
        return (
            f"{where}: every position is rejected: the first, at latitude {latitude:.6f}, longitude "
            f"{longitude:.6f} deg, is {reason.value}{datum}; accepted: within {self._reach / 1e3:g} km of it"
        )


def place_of(columns: Mapping[str, FloatArray]) -> FloatArray:
    """(n, 3) latitude and longitude, rad, and altitude, m; nan: unknown, taken for that of the datum."""
    unknown = np.full(len(columns["latitude"]), np.nan)
    return np.column_stack((columns["latitude"], columns["longitude"], columns.get("altitude", unknown)))


def _east_north(datum: Datum, place: FloatArray) -> FloatArray:
    latitude, longitude = np.degrees(place[:, :2]).T
    return np.column_stack(east_north_up(datum, latitude, longitude, place[:, 2])[:2])
