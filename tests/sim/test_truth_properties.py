# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Properties of the shear truth for any commands, soil and load."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trackslip_common.arrays import FloatArray
from trackslip_common.soils import load_soils
from trackslip_common.vehicle_files import load_vehicle
from trackslip_sim.scenarios.scenario import Scenario, Segment
from trackslip_sim.truth.ground import Ground, Patch, build_ground
from trackslip_sim.truth.rows import Column
from trackslip_sim.truth.settings import TruthSettings, load_settings
from trackslip_sim.truth.shear import ShearDrive

VEHICLE = load_vehicle().whole()
SETTINGS = load_settings()
SOILS = load_soils()
NAMES = st.sampled_from(["sand", "sandy_loam", "clayey_soil", "dry_clay"])
SPEED = st.one_of(st.just(0.0), st.floats(-4.0, 4.0))
SEGMENTS = st.lists(
    st.builds(Segment, duration=st.floats(0.05, 1.5), left=SPEED, right=SPEED), min_size=1, max_size=8
)
RELIEF = st.floats(5e4, 3e7)


def commands(segments: list[Segment]) -> FloatArray:
    return Scenario(name="test", soil="sand", segments=tuple(segments)).commands(SETTINGS.step)


def ground(name: str, *patches: Patch) -> Ground:
    return build_ground(SOILS[name], patches, SOILS)


def run(
    speeds: FloatArray, on: Ground, relief: float = VEHICLE.relief_pressure, every: int = 10
) -> FloatArray:
    """Rows after each ``every`` steps, and the one at the start."""
    return run_loaded(speeds, on, relief, dataclasses.replace(SETTINGS, sample_period=every * SETTINGS.step))


def run_loaded(speeds: FloatArray, on: Ground, relief: float, loaded: TruthSettings) -> FloatArray:
    machine = ShearDrive(on, VEHICLE, loaded, relief)
    return np.vstack([machine.first_row(), machine.drive(speeds)])


@settings(max_examples=20)
@given(segments=SEGMENTS, name=NAMES, relief=RELIEF)
def test_mirrored_commands_mirror_the_run(segments: list[Segment], name: str, relief: float) -> None:
    speeds = commands(segments)
    rows = run(speeds, ground(name), relief)
    mirrored = run(speeds[:, ::-1], ground(name), relief)
    c = Column
    np.testing.assert_allclose(mirrored[:, [c.X, c.V_X]], rows[:, [c.X, c.V_X]], rtol=0, atol=1e-9)
    odd = [c.Y, c.YAW, c.V_Y, c.YAW_RATE]
    np.testing.assert_allclose(mirrored[:, odd], -rows[:, odd], rtol=0, atol=1e-9)
    for pair, tolerance in ((c.TRACK_SPEED, 1e-9), (c.ANGLE, 1e-9), (c.THRUST, 1e-3)):
        swapped = mirrored[:, [pair + 1, pair]]
        np.testing.assert_allclose(swapped, rows[:, pair : pair + 2], rtol=0, atol=tolerance)


@pytest.mark.slow
@given(segments=SEGMENTS, name=NAMES)
def test_machine_is_symmetric_front_to_back(segments: list[Segment], name: str) -> None:
    """Symmetry under a rotation by π: reversed and swapped commands give the reversed path."""
    speeds = commands(segments)
    rows = run(speeds, ground(name))
    turned = run(-speeds[:, ::-1], ground(name))
    np.testing.assert_allclose(turned[:, :2], -rows[:, :2], rtol=0, atol=1e-9)
    np.testing.assert_allclose(turned[:, 2], rows[:, 2], rtol=0, atol=1e-9)


@settings(max_examples=40)
@given(
    segments=SEGMENTS,
    name=NAMES,
    other=NAMES,
    relief=RELIEF,
    load_x=st.floats(-0.2, 0.2),
    load_y=st.floats(-0.35, 0.35),
    edge=st.floats(-0.5, 0.5),
)
def test_energy_is_only_lost_and_all_stays_finite(
    segments: list[Segment], name: str, other: str, relief: float, load_x: float, load_y: float, edge: float
) -> None:
    loaded = dataclasses.replace(SETTINGS, load_x=load_x, load_y=load_y, sample_period=SETTINGS.step)
    patch = Patch(soil=other, from_x=edge, to_x=edge + 0.3, from_y=-0.2, to_y=3.0)
    rows = run_loaded(commands(segments), ground(name, patch), relief, loaded)
    assert np.isfinite(rows).all()
    c = Column
    assert np.abs(rows[:, c.TRACK_SPEED : c.TRACK_SPEED + 2]).max() < 0.51
    kinetic = 0.5 * VEHICLE.mass * (rows[:, c.V_X] ** 2 + rows[:, c.V_Y] ** 2)
    kinetic += 0.5 * VEHICLE.yaw_inertia * rows[:, c.YAW_RATE] ** 2
    assert (rows[:, c.LOSS] >= 0.0).all()
    spare = rows[1:, c.POWER] - rows[1:, c.LOSS] - np.diff(kinetic) / SETTINGS.step
    assert spare.min() > -1e-5  # W; powers are hundreds of W


@settings(max_examples=10)
@given(segments=SEGMENTS, name=NAMES)
def test_every_run_comes_to_rest(segments: list[Segment], name: str) -> None:
    stopped = [*segments, Segment(2.5, 0.0, 0.0)]
    rows = run(commands(stopped), ground(name))
    assert np.abs(rows[-1, [Column.V_X, Column.V_Y, Column.YAW_RATE]]).max() < 1e-5
