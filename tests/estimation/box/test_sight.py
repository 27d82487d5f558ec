# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Every scenario stays in view of the laser and clear of the objects on the site, on firm and soft soils."""

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray

from trackslip_common.arrays import FloatArray
from trackslip_estimation.box import parameters as box
from trackslip_estimation.box.parameters import BoxNodeParameters
from trackslip_sim.machine.driver_settings import default_parameters
from trackslip_sim.machine.scan_model import SiteParameters, SiteScanner
from trackslip_sim.parameters import load_emulator_parameters
from trackslip_sim.scenarios.scenario import load_scenario, scenario_names
from trackslip_sim.truth.record import Truth
from trackslip_sim.truth.simulate import simulate
from trackslip_sim.truth.terrain import FLAT

SOILS = ("sand", "sandy_loam", "clayey_soil", "dry_clay")
PERIOD = 0.5  # s between scans; the box moves less than the beam spacing
CLEARANCE = 1.5  # m from base_link to the nearest object of the site

EMULATOR = load_emulator_parameters({})
LOCALIZER = default_parameters(BoxNodeParameters, box.NODE, *box.DEFAULT_FILES)


def beams_on_box(truth: Truth) -> NDArray[np.int_]:
    """Number of beams on the box per scan: beams with equal ranges with and without the site."""
    alone = dataclasses.replace(EMULATOR.site, walls=(), posts=())
    with_site, without = (SiteScanner(site, EMULATOR.vehicle.box, seed=0) for site in (EMULATOR.site, alone))

    def pose_at(times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        x, y, yaw = (np.interp(times, truth.t, column) for column in (truth.x, truth.y, truth.yaw))
        return x, y, yaw

    counts = []
    for stamp in np.arange(0.0, truth.duration, PERIOD):
        box_only = without.true_ranges(stamp, pose_at)
        counts.append(np.sum(np.isfinite(box_only) & (with_site.true_ranges(stamp, pose_at) == box_only)))
    return np.array(counts)


def clearance(truth: Truth, site: SiteParameters) -> float:
    """Least distance of base_link from a wall or post, m."""
    path = np.column_stack((truth.x, truth.y))
    distances = [np.hypot(*(path - (x, y)).T) - radius for x, y, radius in np.reshape(site.posts, (-1, 3))]
    for begin, end in np.reshape(site.walls, (-1, 2, 2)):
        along = end - begin
        share = np.clip((path - begin) @ along / (along @ along), 0.0, 1.0)
        distances.append(np.hypot(*(path - begin - share[:, np.newaxis] * along).T))
    return float(np.min(distances))


SCENARIOS = [  # others have another vehicle, or leave the level site
    name
    for name in scenario_names()
    if not load_scenario(name).has_swing and load_scenario(name).terrain == FLAT
]


@pytest.mark.parametrize(
    "soil", [SOILS[0], *(pytest.param(soil, marks=pytest.mark.slow) for soil in SOILS[1:])]
)
@pytest.mark.parametrize("name", SCENARIOS)
def test_the_box_stays_in_sight(name: str, soil: str) -> None:
    truth = simulate(load_scenario(name), soil=soil)
    assert beams_on_box(truth).min() > LOCALIZER.minimum_beams
    assert clearance(truth, EMULATOR.site) >= CLEARANCE


def test_the_field_trial_is_as_described() -> None:
    segments = load_scenario("field_trial").segments
    duration = sum(s.duration for s in segments)

    def share(chosen: list[bool]) -> float:
        return sum(s.duration for s, is_chosen in zip(segments, chosen, strict=True) if is_chosen) / duration

    assert share([s.left == s.right != 0.0 for s in segments]) >= 0.4  # straight, at a steady speed
    assert 0.05 <= share([s.left == s.right == 0.0 for s in segments]) <= 0.2
    assert 0.1 <= share([s.left + s.right < 0.0 for s in segments]) <= 0.3
    assert {np.sign(s.right - s.left) for s in segments} == {-1.0, 0.0, 1.0}
