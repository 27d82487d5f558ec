# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Distance by the tracks against distance by the fixes: units of speed, rolling radius, a gear of the travel drive.

    ρ = distance by fixes / distance by tracks = (1 − i) / f       i slip, f factor of the mistake

Slip has one side: tracks run ahead of the machine, seldom by more than half on a whole drive, and behind it
only by some per cent, downhill. ρ above 1.1 is no slip, and a factor of 2 holds on the best ground of the log too.
"""

import numpy as np

from trackslip_estimation.setup_check.finding import Cause, Undetermined, odds_of
from trackslip_estimation.setup_check.fit import Scales
from trackslip_estimation.setup_check.grid import Grid, window_edges, window_sums
from trackslip_estimation.setup_check.heading import place_at
from trackslip_estimation.setup_check.log import Fixes, Machine

UNITS = {  # speed by the tracks over what it should be
    "rpm, declared rad/s": 60.0 / (2.0 * np.pi),
    "rad/s, declared rpm": 2.0 * np.pi / 60.0,
    "rev/s, declared rad/s": 1.0 / (2.0 * np.pi),
    "rad/s, declared rev/s": 2.0 * np.pi,
    "deg/s, declared rad/s": np.degrees(1.0),
    "rad/s, declared deg/s": np.radians(1.0),
    "rpm, declared rev/s": 60.0,
    "km/h, declared m/s": 3.6,
    "m/s, declared km/h": 1.0 / 3.6,
    "the diameter instead of the radius": 2.0,
    "half of the radius": 0.5,
    "mm/s, declared m/s": 1e3,
    "m/s, declared mm/s": 1e-3,
    "cm/s, declared m/s": 1e2,
    "m/s, declared cm/s": 1e-2,
}
_LEAST_WINDOWS = 5
_RADIUS_RANGE = (1.10, 1.75)  # of ρ: the stated radius is too small
_SLIP = 0.08  # mean slip of a drive, of an exponential prior
_AHEAD = 0.04  # standard deviation of how much a machine goes ahead of its tracks
_LEAST_DISTANCE = 5.0  # m
_GEAR = (1.25, 3.0)  # ratio of displacements
_BEST = 80.0  # percentile of ρ: the best ground of the drive


def rough_scale(grid: Grid, fixes: Fixes) -> float:
    """ρ on the fastest straights, whatever the signs of the tracks are; nan where there is too little motion."""
    length = 2.0
    steps = np.diff(place_at(fixes, window_edges(grid, length)), axis=0)
    way = np.hypot(*steps.T)
    tracks = window_sums(grid, grid.tracks, length)
    noise = float(np.median(fixes.stddevs)) if len(fixes.stddevs) else 0.0
    sound = np.isfinite(way) & np.isfinite(tracks).all(axis=1)
    if sound.sum() < _LEAST_WINDOWS:
        return float("nan")
    way, tracks = way[sound], tracks[sound]
    own = np.maximum(np.abs(tracks.sum(axis=1)), np.abs(tracks[:, 1] - tracks[:, 0])) / 2.0
    fast = own > 0.6 * np.percentile(own, 95)
    fast &= own > 0.0
    if fast.sum() < 3 or float(np.median(way[fast])) < max(3.0 * noise, 0.05):
        return float("nan")
    return float(np.percentile(way[fast] / own[fast], 70))


def unit_of(rho: float) -> float:
    """Factor that a rough ρ asks for; 1 where slip or a radius may explain it."""
    if not np.isfinite(rho) or 0.3 <= rho <= 1.75:
        return 1.0
    return min(UNITS.values(), key=lambda f: abs(np.log(rho * f)))


def slip_log(rho: float) -> float:
    """Ln density of ln ρ for right units: slip, or some per cent of going ahead."""
    slip = 1.0 - rho
    if slip >= 0.0:
        return -min(slip, 1.0) / _SLIP
    return -0.5 * (slip / _AHEAD) ** 2


class Ratios:
    """ρ of the segments of a drive, by what they weigh."""

    def __init__(self, found: Scales) -> None:
        use = found.straight > 0.7 if (found.straight > 0.7).sum() >= _LEAST_WINDOWS else found.straight >= 0.0
        self.values, self.times = found.ratios[use], found.times[use]

    @property
    def best(self) -> float:
        """On the best ground."""
        return float(np.percentile(self.values, _BEST))

    @property
    def middle(self) -> float:
        """Median."""
        return float(np.median(self.values))

    @property
    def spread(self) -> float:
        """Half width of the 95 % interval of the median."""
        scatter = 1.4826 * float(np.median(np.abs(self.values - self.middle)))
        return 2.0 * 1.25 * scatter / float(np.sqrt(len(self.values))) + 0.01


def judge(
    found: Scales | None, machine: Machine, factor: float, distance: float
) -> tuple[list[Cause], list[Undetermined]]:
    """``factor``: of the unit, undone in ``found`` already; ``distance``: by the fixes, m."""
    if found is None or len(found.ratios) < _LEAST_WINDOWS or distance < _LEAST_DISTANCE:
        needed = f"drive {max(10.0, _LEAST_DISTANCE):g} m straight with fixes"
        return [], [Undetermined("unit of the speeds and rolling radius", needed)]
    ratios = Ratios(found)
    whole = ratios.best / factor  # of what was recorded
    names = {name: slip_log(whole * f) for name, f in UNITS.items()}
    best = max(names, key=lambda name: names[name])
    gain = names[best] - max(slip_log(whole), -60.0) - 1.0
    gear = _gear(ratios, factor)
    if gear is not None:
        return [gear], []
    in_radius = _RADIUS_RANGE[0] < whole <= _RADIUS_RANGE[1]
    if in_radius and names[best] < -3.0 and ratios.values.min() / factor > 1.0 or (
        in_radius and ratios.middle - ratios.spread > _RADIUS_RANGE[0] * factor
    ):
        return [_radius(ratios, machine, factor)], []
    if gain > np.log(100.0) and names[best] > -4.0 and not 0.55 < whole < 1.3:
        value = UNITS[best]
        evidence = f"fixes go {whole:.3g} times as far as the tracks; as {best}, {whole * value:.2f} times"
        remedy = (
            "State the unit in which the speeds are (mapping: left_velocity and right_velocity: unit; roles file: "
            f"unit), or vehicle.kinematics.rolling_radius: {machine.radius / value:.4g}"
        )
        return [Cause("speed_unit", "sprockets", evidence, odds_of(gain), remedy)], []
    if ratios.best < 0.9 and ratios.best > 0.55:
        needed = "drive 10 m straight on hard level ground: there the tracks hardly slip"
        return [], [Undetermined(f"slip of {1.0 - ratios.best:.0%}, or a rolling radius that is too large", needed)]
    return [], []


def _radius(ratios: Ratios, machine: Machine, factor: float) -> Cause:
    rho, spread = ratios.middle / factor, ratios.spread / factor
    low, high = (machine.radius * (rho + sign * spread) for sign in (-1.0, 1.0))
    evidence = f"the machine goes {rho:.3f} ± {spread:.3f} times as far as its tracks: no slip does that"
    remedy = f"Set vehicle.kinematics.rolling_radius: {machine.radius * rho:.3g} (m, {low:.3g} to {high:.3g})"
    log_ratio = 0.5 * ((rho - 1.0) / _AHEAD) ** 2
    return Cause("rolling_radius", "sprockets", evidence, odds_of(log_ratio), remedy)


def _gear(ratios: Ratios, factor: float) -> Cause | None:
    """Two levels of ρ with one ratio, the upper of which no slip explains."""
    values = ratios.values / factor
    order = np.sort(values)
    gaps = np.diff(np.log(np.maximum(order, 1e-6)))
    count = len(order)
    if count < 2 * 3:
        return None
    inner = slice(2, count - 3)
    if not len(gaps[inner]):
        return None
    k = int(np.argmax(gaps[inner])) + 2
    low, high = order[: k + 1], order[k + 1 :]
    ratio = float(np.median(high) / np.median(low))
    scatter = max(float(np.std(np.log(low))), float(np.std(np.log(high))))
    switches = int((np.diff((values > high[0] - 1e-9).astype(np.int64)[np.argsort(ratios.times)]) != 0).sum())
    if not _GEAR[0] < ratio < _GEAR[1] or scatter > 0.25 * np.log(ratio) or float(np.median(high)) < 1.15:
        return None
    if float(np.median(low)) > 1.12 or switches > count // 3:
        return None
    evidence = (
        f"the machine goes {np.median(low):.2f} times as far as its tracks in {len(low)} pieces of the drive, and "
        f"{np.median(high):.2f} times in {len(high)}: a travel motor of {ratio:.2f} times the displacement"
    )
    remedy = (
        f"State the gear: speeds from flows are {ratio:.3g} times as large in the high gear; use left_position and "
        "right_position of the sprockets in the roles file, or record each gear by itself"
    )
    log_ratio = len(high) * 0.5 * ((float(np.median(high)) - 1.0) / 0.1) ** 2
    return Cause("travel_gear", "sprockets", evidence, odds_of(log_ratio), remedy)


def distance_of(fixes: Fixes, grid: Grid) -> float:
    """Metres by the fixes, in steps that stand out of their noise."""
    steps = np.diff(place_at(fixes, window_edges(grid)), axis=0)
    way = np.hypot(*steps.T)
    noise = float(np.median(fixes.stddevs)) if len(fixes.stddevs) else 0.0
    with np.errstate(invalid="ignore"):
        return float(np.nansum(way[way > 3.0 * noise]))


