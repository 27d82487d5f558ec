# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The shear truth on slopes: holding and sliding, energy, loads, and equality with flat ground."""

import dataclasses
import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackslip_common.arrays import FloatArray
from trackslip_common.errors import InputError
from trackslip_common.soils import load_soils
from trackslip_common.vehicle import Vehicle
from trackslip_common.vehicle_files import load_vehicle
from trackslip_estimation.terramechanics.elements import element_positions
from trackslip_sim.machine.placement import Placement
from trackslip_sim.scenarios.scenario import Scenario, Segment, load_scenario
from trackslip_sim.scenarios.terrains import load_terrain
from trackslip_sim.truth.contact import Tracks
from trackslip_sim.truth.ground import build_ground
from trackslip_sim.truth.load import Load, distribute_load
from trackslip_sim.truth.pose import advance_pose, body_rates
from trackslip_sim.truth.record import Truth
from trackslip_sim.truth.rows import Column
from trackslip_sim.truth.settings import load_settings
from trackslip_sim.truth.shear import ShearDrive
from trackslip_sim.truth.simulate import simulate
from trackslip_sim.truth.terrain import FLAT, Hill, Plane, Ramp, Terrain, heights, shape_at

VEHICLE = load_vehicle().whole()
SETTINGS = load_settings()
SOILS = load_soils()
NAMES = ("sand", "sandy_loam", "clayey_soil", "dry_clay")
FAST = 2.3
SLOPES = ("slope_15", "slope_down_15", "side_slope_15", "ramp_up", "ramp_down", "hill", "hollow")

# Reference without a terrain: 40 s of a scenario; x, y, yaw, left thrust of the last sample.
BEFORE = {
    ("thesis", "sand"): (7.735681585726676, -2.7226589034870003, -0.559265154600817),
    ("patches", "sand"): (13.13074961918659, -2.637814795301543, -0.7456943236096372),
    ("spot_turn", "clayey_soil"): (5.500102684291202, 0.032380380562866067, 0.011179775885837785),
}


def drive(terrain: Terrain, *segments: tuple[float, float, float], soil: str = "sand") -> Scenario:
    return Scenario(name="test", soil=soil, segments=tuple(Segment(*s) for s in segments), terrain=terrain)


def plane(slope: float, direction: float = 0.0) -> Terrain:
    """A plane with a slope in rad, rising towards a direction in rad."""
    return Terrain("plane", (Plane(direction, slope),))


def lowered(height: float) -> Vehicle:
    assert VEHICLE.centre_of_gravity is not None
    return dataclasses.replace(
        VEHICLE, centre_of_gravity=dataclasses.replace(VEHICLE.centre_of_gravity, z=height)
    )


@pytest.mark.parametrize(("name", "soil"), sorted(BEFORE))
def test_flat_ground_ends_at_the_reference_poses(name: str, soil: str) -> None:
    truth = simulate(load_scenario(name).with_duration(40.0), soil=soil)
    end = truth.x[-1], truth.y[-1], truth.yaw[-1]
    assert end == pytest.approx(BEFORE[name, soil], abs=1e-9)
    assert not np.any([truth.z, truth.pitch, truth.roll, truth.pitch_rate, truth.roll_rate])
    assert truth.left_load == pytest.approx(0.5 * VEHICLE.weight)


def test_plane_without_slope_equals_flat_ground() -> None:
    scenario = load_scenario("slalom")
    low = lowered(0.0)  # no load transfer by acceleration
    flat = simulate(scenario, vehicle=low)
    level = simulate(dataclasses.replace(scenario, terrain=plane(0.0)), vehicle=low)
    for name in ("x", "y", "yaw", "left_thrust", "right_slip"):
        assert getattr(level, name) == pytest.approx(getattr(flat, name), abs=1e-9)


def limit_of(soil: str, direction: float) -> float:
    """Tangent of the limit slope of locked tracks: they shear and plough ahead, and only shear sideways."""
    ground = SOILS[soil]
    adhesion = ground.cohesion * 2.0 * VEHICLE.track_width * VEHICLE.contact_length / VEHICLE.weight
    friction = math.tan(ground.friction_angle) + (ground.value("mu_r") if direction == 0.0 else 0.0)
    slope = 0.5
    for _ in range(100):
        slope = math.atan(friction + adhesion / math.cos(slope))
    return math.tan(slope)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("direction", [0.0, 0.5 * math.pi])
def test_machine_slides_only_on_slopes_above_the_soil_limit(name: str, direction: float) -> None:
    limit = limit_of(name, direction)
    low = lowered(0.2)  # a higher machine would tip over before it slides
    for share, holds in ((0.95, True), (1.03, False)):
        terrain = plane(math.atan(share * limit), direction)
        truth = simulate(drive(terrain, (10.0, 0.0, 0.0), soil=name), vehicle=low)
        moved = float(np.hypot(truth.x[-1], truth.y[-1]))
        assert moved < 0.005 if holds else moved > 3.0
        speed = np.hypot(truth.v_x[-1], truth.v_y[-1])
        assert speed < 5e-4 if holds else speed > 0.5  # soil and oil creep while holding


def test_a_weak_soil_stalls_uphill_and_lets_a_machine_slide_across() -> None:
    hill = simulate(drive(load_terrain("slope_15"), (20.0, FAST, FAST), soil="clayey_soil"))
    assert hill.left_slip[-1] > 0.9
    assert hill.x.max() < 0.5
    side = simulate(drive(load_terrain("side_slope_15"), (20.0, FAST, FAST), soil="clayey_soil"))
    assert side.slip_angle[-1] < -0.015  # crabs downhill
    firm = simulate(drive(load_terrain("side_slope_15"), (20.0, FAST, FAST), soil="sand"))
    assert side.slip_angle[-1] < firm.slip_angle[-1] < 0.0


@pytest.mark.parametrize("slope", [-0.25, 0.1, 0.2])
def test_weight_along_the_slope_is_thrust_and_no_resistance(slope: float) -> None:
    end = simulate(drive(plane(slope), (20.0, FAST, FAST))).interpolate(20.0)
    normal = VEHICLE.weight * math.cos(slope)
    resistance = SOILS["sand"].value("mu_r") * normal
    assert end.left_resistance + end.right_resistance == pytest.approx(resistance, rel=1e-3)
    thrust = resistance + VEHICLE.weight * math.sin(slope)
    assert end.left_thrust + end.right_thrust == pytest.approx(thrust, rel=1e-2)
    assert end.pitch == pytest.approx(-slope)
    assert end.z == pytest.approx(math.tan(slope) * end.x)
    assert end.left_load == pytest.approx(0.5 * normal)


def test_lower_track_carries_more_load() -> None:
    slope = math.radians(10.0)
    end = simulate(drive(plane(slope, 0.5 * math.pi), (3.0, 0.0, 0.0))).interpolate(3.0)
    assert VEHICLE.centre_of_gravity is not None
    shift = VEHICLE.weight * VEHICLE.centre_of_gravity.z * math.sin(slope) / VEHICLE.tread
    assert end.roll == pytest.approx(slope)
    assert end.right_load - end.left_load == pytest.approx(2.0 * shift, rel=1e-3)


def energies(rows: FloatArray, step: float) -> tuple[float, float]:
    """Energy lost over rows a step apart, and work of the tracks that is not accounted for, J.

    Forces are those at the end of a step. Distances follow from the mean velocity in the axes at its end.
    """
    c, half = Column, 0.5 * VEHICLE.tread
    q = rows[:, [c.V_X, c.V_Y, c.YAW_RATE]]
    cos, sin = np.cos(step * q[:-1, 2]), np.sin(step * q[:-1, 2])
    ahead, left = cos * q[:-1, 0] + sin * q[:-1, 1], cos * q[:-1, 1] - sin * q[:-1, 0]
    mean = 0.5 * (np.column_stack((ahead, left, q[:-1, 2])) + q[1:])
    over_ground = mean[:, :1] + half * np.array((-1.0, 1.0)) * mean[:, 2:]
    tracks = 0.5 * (rows[1:] + rows[:-1])[:, c.TRACK_SPEED : c.TRACK_SPEED + 2]
    thrust, rolling = rows[1:, c.THRUST : c.THRUST + 2], rows[1:, c.RESISTANCE : c.RESISTANCE + 2]
    work = step * np.sum(thrust * tracks)
    power = np.sum(thrust * (tracks - over_ground) + rolling * over_ground)
    power += np.sum(rows[1:, c.MOMENT] * mean[:, 2] - rows[1:, c.SIDE] * mean[:, 1])
    lost = step * float(power)
    inertia = np.array((VEHICLE.mass, VEHICLE.mass, VEHICLE.yaw_inertia))
    kinetic = 0.5 * float(np.sum((q[-1] ** 2 - q[0] ** 2) * inertia))
    gained = VEHICLE.weight * (rows[-1, c.Z] - rows[0, c.Z])
    return lost, float(work - lost - kinetic - gained)


@cache
def steps_of(name: str, soil: str) -> FloatArray:
    """Half a minute of the field trial on a slope, one row per step."""
    settings = dataclasses.replace(SETTINGS, sample_period=SETTINGS.step)
    ground = build_ground(SOILS[soil], (), SOILS, load_terrain(name))
    machine = ShearDrive(ground, VEHICLE, settings, VEHICLE.relief_pressure)
    commands = load_scenario("field_trial").with_duration(30.0).commands(settings.step)
    return np.vstack([machine.first_row(), machine.drive(commands)])


@pytest.mark.parametrize("name", SLOPES)
@pytest.mark.parametrize("soil", [pytest.param("sand", marks=pytest.mark.slow), "clayey_soil"])
def test_energy_balances(name: str, soil: str) -> None:
    lost, missing = energies(steps_of(name, soil), SETTINGS.step)
    assert lost > 5e3
    assert abs(missing) <= 1e-6 * lost


@pytest.mark.parametrize("name", ["hill", "slope_down_15"])
@pytest.mark.parametrize("soil", ["sand", pytest.param("clayey_soil", marks=pytest.mark.slow)])
def test_halving_the_step_moves_the_end_by_less_than_a_millimetre(name: str, soil: str) -> None:
    scenario = dataclasses.replace(
        load_scenario("field_trial").with_duration(30.0), terrain=load_terrain(name), soil=soil
    )
    truth = simulate(scenario, settings=dataclasses.replace(SETTINGS, step=0.5 * SETTINGS.step))
    end = steps_of(name, soil)[-1, [Column.X, Column.Y, Column.Z]]
    assert math.dist(end, (truth.x[-1], truth.y[-1], truth.z[-1])) < 1e-3


@given(x=st.floats(-0.6, 0.6), y=st.floats(-0.33, 0.33))
def test_pressed_elements_carry_the_weight_where_it_is(x: float, y: float) -> None:
    length, tread, n = 1.264, 0.73, 400
    tracks = Tracks(element_positions(length, n), np.zeros((2, n)), length * 0.23 / n, 0.5 * tread, length)
    load = Load(np.zeros(4), np.zeros(2), np.zeros(3), np.array((1e4, x, y)), np.zeros(2), np.zeros(1))
    distribute_load(load, tracks)
    assert not load.tipped[0]
    assert tracks.load.min() >= 0.0
    assert tracks.load.sum() == pytest.approx(1e4)
    assert np.sum(tracks.load * tracks.x_e) / 1e4 == pytest.approx(x, abs=length / n)
    assert 0.5 * tread * (tracks.load[0].sum() - tracks.load[1].sum()) / 1e4 == pytest.approx(y)
    lifted = np.mean(tracks.load[0] == 0.0)
    assert lifted == pytest.approx(max(0.0, 1.0 - 3.0 * (0.5 - abs(x) / length)), abs=2.0 / n)


def test_a_machine_that_tips_over_is_refused() -> None:
    with pytest.raises(InputError, match=r"terrain 'plane': the machine tips over.*accepted"):
        simulate(drive(plane(math.radians(35.0), 0.5 * math.pi), (1.0, 0.0, 0.0)))


def test_hill_narrower_than_the_machine_is_refused() -> None:
    with pytest.raises(InputError, match=r"radius 2 m is refused; accepted: >= 2\.53 m"):
        simulate(drive(Terrain("knob", (Hill(5.0, 0.0, 0.5, 1.0),)), (1.0, 1.0, 1.0)))


def test_mode_thesis_refuses_a_terrain() -> None:
    with pytest.raises(InputError, match="terrain 'hill': mode thesis"):
        simulate(load_scenario("hill"), mode="thesis")


ANGLE, PLACE = st.floats(-3.1, 3.1), st.floats(-20.0, 20.0)
FEATURES = st.one_of(
    st.builds(Plane, ANGLE, st.floats(-0.6, 0.6)),
    st.builds(Ramp, ANGLE, st.floats(-0.6, 0.6), PLACE, st.floats(4.0, 9.0), st.floats(2.0, 4.0)),
    st.builds(Hill, PLACE, PLACE, st.floats(-2.0, 2.0), st.floats(4.0, 9.0)),
)
TERRAINS = st.lists(FEATURES, min_size=1, max_size=2).map(lambda features: Terrain("any", tuple(features)))


@given(terrain=TERRAINS, x=PLACE, y=PLACE)
def test_slopes_and_bends_are_derivatives_of_the_height(terrain: Terrain, x: float, y: float) -> None:
    ground, shape, aside = terrain.map, np.zeros(6), np.zeros(6)
    shape_at(x, y, ground, shape)
    for axis, (first, seconds) in enumerate(((1, (3, 4)), (2, (4, 5)))):
        ends = []
        for side in (-1e-5, 1e-5):
            shape_at(x + side * (axis == 0), y + side * (axis == 1), ground, aside)
            ends.append(aside[:3].copy())
        derivatives = (ends[1] - ends[0]) / 2e-5
        assert derivatives[0] == pytest.approx(shape[first], abs=1e-6)
        assert derivatives[1:] == pytest.approx(shape[list(seconds)], abs=1e-4)
    assert heights(terrain, [0.0], [0.0])[0] == pytest.approx(0.0, abs=1e-12)


@given(terrain=TERRAINS, x=PLACE, y=PLACE, yaw=ANGLE, v=st.tuples(*[st.floats(-0.5, 0.5)] * 3))
def test_pose_advances_along_the_ground_by_the_body_rates(
    terrain: Terrain, x: float, y: float, yaw: float, v: tuple[float, float, float]
) -> None:
    step, ground, shape = 1e-3, terrain.map, np.zeros(6)
    velocity = np.array(v)
    places = []
    for side in (-step, step):
        pose = np.array((x, y, yaw))
        advance_pose(pose, velocity, velocity, ground, side)
        places.append(lying(pose, terrain))
    before, after = places
    direction = np.array((after.x - before.x, after.y - before.y, after.z - before.z)) / (2.0 * step)
    here = lying(np.array((x, y, yaw)), terrain).rotation()
    np.testing.assert_allclose(here.T @ direction, (v[0], v[1], 0.0), atol=1e-4)
    turned = here.T @ (after.rotation() - before.rotation()) / (2.0 * step)
    shape_at(x, y, ground, shape)
    expected = (*body_rates(shape, yaw, *v), v[2])
    np.testing.assert_allclose((turned[2, 1], turned[0, 2], turned[1, 0]), expected, atol=1e-4)


def lying(pose: FloatArray, terrain: Terrain) -> Placement:
    """Pose of the machine on the terrain, with its z axis along the surface normal."""
    shape = np.zeros(6)
    shape_at(pose[0], pose[1], terrain.map, shape)
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    up = np.array((-shape[1], -shape[2], 1.0)) / math.sqrt(1.0 + shape[1] ** 2 + shape[2] ** 2)
    ahead = np.array((cos, sin, cos * shape[1] + sin * shape[2]))
    ahead /= np.linalg.norm(ahead)
    left = np.cross(up, ahead)
    pitch, roll = -math.asin(ahead[2]), math.atan2(left[2], up[2])
    return Placement(x=pose[0], y=pose[1], z=shape[0], yaw=pose[2], pitch=pitch, roll=roll)


def test_recorded_height_and_rates_match_the_ground() -> None:
    terrain = load_terrain("hill")
    truth: Truth = simulate(load_scenario("hill"))
    assert truth.z[::20] == pytest.approx(heights(terrain, truth.x[::20], truth.y[::20]), abs=1e-12)
    assert truth.z.max() > 2.5
    roll_rate = np.gradient(truth.roll, truth.t) - np.gradient(truth.yaw, truth.t) * np.sin(truth.pitch)
    inner = slice(1, -1)
    assert truth.roll_rate[inner] == pytest.approx(roll_rate[inner], abs=2e-3)


def test_bucket_load_shifts_the_weight_forward() -> None:
    segments = (
        Segment(2.0, 0.0, 0.0),
        Segment(10.0, FAST, FAST, load=100.0),
        Segment(4.0, FAST, FAST, load=0.0),
    )
    scenario = Scenario(name="test", soil="sand", segments=segments)
    truth = simulate(scenario)
    empty, loaded, emptied = (truth.interpolate(t) for t in (1.0, 11.0, 15.0))
    assert empty.left_load == emptied.left_load == pytest.approx(0.5 * VEHICLE.weight)
    assert loaded.left_load == pytest.approx(0.5 * VEHICLE.weight * (1.0 + 100.0 / VEHICLE.mass))
    assert loaded.left_resistance == pytest.approx(0.2 * loaded.left_load, rel=1e-3)
    unloaded = simulate(drive(FLAT, (2.0, 0.0, 0.0), (10.0, FAST, FAST))).interpolate(11.0)
    share = loaded.left_thrust / unloaded.left_thrust * unloaded.left_slip / loaded.left_slip
    assert share < 1.0  # less sheared soil is stiffer, so slip grows faster than thrust


def test_a_cab_that_swings_shifts_the_weight() -> None:
    machine = load_vehicle("pc05_cab")
    whole, upper = machine.whole(), machine.upper_structure
    assert upper is not None
    segments = Segment(1.0, 0.0, 0.0), Segment(9.0, 0.0, 0.0, swing_to=0.5 * math.pi)
    scenario = Scenario(name="test", soil="sand", segments=segments)
    truth = simulate(scenario, vehicle=whole, upper=upper)
    shift = upper.mass * upper.centre_x / whole.mass
    assert truth.left_load[0] == truth.right_load[0]
    expected = 0.5 * whole.weight * (1.0 + 2.0 * shift / whole.tread)
    assert truth.left_load[-1] == pytest.approx(expected, rel=1e-3)
    assert truth.left_load + truth.right_load == pytest.approx(whole.weight)


def test_a_load_without_a_bucket_is_refused() -> None:
    bare = dataclasses.replace(VEHICLE, bucket=None)
    scenario = Scenario(name="test", soil="sand", segments=(Segment(1.0, 0.0, 0.0, load=10.0),))
    with pytest.raises(InputError, match=r"'test' loads the bucket; accepted: a vehicle with mass\.bucket"):
        simulate(scenario, vehicle=bare)
