# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The load of the tracks on a slope, against the loads of the simulated truth and its limits."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackslip_common.units import GRAVITY
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.soil.ground_load import (
    GROUND_LOAD,
    bucket_load_variance,
    new_bucket_load,
    new_gravity_centre,
    set_ground_load,
    update_bucket_load,
)
from trackslip_estimation.soil.interpolation import SAMPLE
from trackslip_estimation.soil.shear_field import (
    Contact,
    Rolling,
    RollingError,
    fill_mobilised_shares,
)
from trackslip_estimation.soil.soil_parameters import load_soil_parameters, make_config
from trackslip_estimation.terramechanics.elements import element_positions
from trackslip_sim.scenarios.scenario import load_scenario
from trackslip_sim.truth.mass_properties import MassProperties
from trackslip_sim.truth.settings import load_settings

P = load_soil_parameters()
VEHICLE = P.vehicle.whole()
NUMBERS = make_config(P)[0]
CENTRE = VEHICLE.centre_of_gravity
GRAVITY_CENTRE = new_gravity_centre(P.vehicle)
CAB = load_soil_parameters({"vehicle": "pc05_cab"})
TILT = st.floats(-0.35, 0.35)


def load_at(
    roll: float, pitch: float, variance: float = 0.0, centre: Any = GRAVITY_CENTRE, p: Any = NUMBERS
) -> Any:
    return load_swung(0.0, math.inf, centre, p, ((roll, pitch), (variance, variance)))


def load_swung(
    swing: float, stddev: float, centre: Any = None, p: Any = NUMBERS, tilt: Any = ((0.0, 0.0), (0.0, 0.0))
) -> Any:
    """Load of a PC05 with a cab, unless ``centre`` is given."""
    sample, load = np.zeros(1, SAMPLE)[0], np.zeros(1, GROUND_LOAD)[0]
    sample["tilt"], sample["tilt_variance"] = tilt
    sample["swing"], sample["swing_variance"] = swing, stddev**2
    set_ground_load(load, (new_gravity_centre(CAB.vehicle) if centre is None else centre)[0], sample, p)
    return load


def test_level_ground_halves_the_weight() -> None:
    load = load_at(0.0, 0.0)
    assert load["normal"].tolist() == pytest.approx([0.5 * VEHICLE.weight] * 2)
    assert load["strength"].tolist() == [1.0, 1.0]
    assert (load["pull"], load["lean"], load["stretch"]) == (0.0, 0.0, 1.0)
    assert not load["strength_variance"].any()


@given(roll=TILT, pitch=TILT)
def test_track_loads_balance_the_weight_and_its_moment(roll: float, pitch: float) -> None:
    assert CENTRE is not None
    load, mass = load_at(roll, pitch), VEHICLE.mass
    down = mass * GRAVITY * math.cos(pitch) * math.cos(roll)
    assert load["normal"].sum() == pytest.approx(down)
    assert load["pull"] == pytest.approx(mass * GRAVITY * math.sin(pitch), abs=1e-9)
    aside = -mass * GRAVITY * math.cos(pitch) * math.sin(roll)
    moment = 0.5 * VEHICLE.tread * (load["normal"][0] - load["normal"][1])
    assert moment == pytest.approx(CENTRE.z * aside, abs=1e-6)


def load_stddev(vehicle: Any, moments: list[tuple[float, Motion]]) -> float:
    """Standard deviation of the thrust for a weight of 1 N, after (seconds, motion) of ``moments``."""
    bucket_load, sample = new_bucket_load(vehicle)[0], np.zeros(1, SAMPLE)[0]
    sample["dt"] = 0.1
    for seconds, motion in moments:
        sample["motion"] = motion
        for _ in range(round(seconds * 10)):
            update_bucket_load(bucket_load, sample, NUMBERS["load"])
    return math.sqrt(bucket_load_variance(bucket_load, 1.0, NUMBERS["load"]))


def test_load_is_uncertain_after_a_long_standstill_with_a_bucket() -> None:
    """The first drive has the weight of the file; a short halt or no bucket adds no uncertainty."""
    standstill, drive, halt = (8.0, Motion.STANDING), (5.0, Motion.STRAIGHT), (2.0, Motion.STANDING)
    assert VEHICLE.bucket is not None
    assert load_stddev(VEHICLE, [standstill, drive]) == 0.0
    assert load_stddev(VEHICLE, [standstill, drive, halt, drive, halt]) == 0.0
    assert load_stddev(VEHICLE, [standstill, drive, standstill, drive]) == pytest.approx(P.load.bucket_share)
    assert load_stddev(replace(VEHICLE, bucket=None), [standstill, drive, standstill, drive]) == 0.0


def test_downhill_pitch_pulls_forward_and_loads_the_front() -> None:
    load = load_at(0.0, 0.2)
    assert load["pull"] > 0.0
    assert load["lean"] > 0.0
    assert load["stretch"] == pytest.approx(1.0 / math.cos(0.2))


def test_strength_without_cohesion_is_proportional_to_the_load() -> None:
    dry = load_soil_parameters({"load.friction_share": 1.0, "load.friction_share_stddev": 0.0})
    load = load_at(0.25, 0.0, p=make_config(dry)[0])
    assert load["strength"].tolist() == pytest.approx((2.0 * load["normal"] / VEHICLE.weight).tolist())
    assert not load["strength_variance"].any()
    assert load_at(0.25, 0.0)["strength_variance"].min() > 0.0


def test_unknown_height_of_the_centre_of_mass_widens_the_track_loads() -> None:
    assert P.vehicle.mass is not None
    unknown = new_gravity_centre(replace(P.vehicle, mass=replace(P.vehicle.mass, centre_of_gravity=None)))
    blind, known = load_at(0.2, 0.0, centre=unknown), load_at(0.2, 0.0)
    assert blind["normal"][0] == pytest.approx(blind["normal"][1])
    assert blind["strength_variance"].min() > 4.0 * known["strength_variance"].max()


def test_uncertain_pitch_widens_the_pull() -> None:
    assert load_at(0.0, 0.1, variance=1e-4)["pull_variance"] == pytest.approx(
        (VEHICLE.weight * math.cos(0.1) * 0.01) ** 2
    )


@given(swing=st.floats(-7.0, 7.0))
def test_track_loads_with_a_swung_cab_equal_those_of_the_truth(swing: float) -> None:
    load, upper = load_swung(swing, 0.0), CAB.vehicle.upper_structure
    properties = MassProperties(load_scenario("field_trial"), CAB.vehicle.whole(), upper, load_settings())
    _, x_g, y_g, _ = properties.rows(np.array((swing,)), 0, 1)[0]
    assert load["normal"].sum() == pytest.approx(VEHICLE.weight)
    moment = 0.5 * VEHICLE.tread * (load["normal"][0] - load["normal"][1])
    assert moment == pytest.approx(VEHICLE.weight * y_g, abs=1e-9)
    lean = P.load.friction_share * 12.0 * x_g / VEHICLE.contact_length**2
    assert load["lean"] == pytest.approx(lean, abs=1e-12)
    assert load["lean_stddev"] == 0.0


@pytest.mark.parametrize("swing", [0.7, 3.0])
@pytest.mark.parametrize("stddev", [0.1, math.inf])
def test_uncertain_swing_widens_the_track_loads_as_by_sampling(swing: float, stddev: float) -> None:
    rng = np.random.default_rng(1)
    angles = swing + stddev * rng.standard_normal(4000) if stddev < 9.0 else rng.uniform(-np.pi, np.pi, 4000)
    loads = [load_swung(angle, 0.0) for angle in angles.tolist()]
    load = load_swung(swing, stddev)
    for name in ("strength", "lean"):
        values = np.array([one[name] for one in loads])
        assert load[name] == pytest.approx(values.mean(axis=0), abs=0.08 * np.std(values) + 1e-3)
    leans, strengths = (np.array([one[name] for one in loads]) for name in ("lean", "strength"))
    assert load["lean_stddev"] == pytest.approx(leans.std(), rel=0.05)
    friction = np.square(P.load.friction_share_stddev * (2.0 * load["normal"] / VEHICLE.weight - 1.0))
    assert load["strength_variance"] - friction == pytest.approx(strengths.var(axis=0), rel=0.05)


def test_swing_angle_has_no_effect_without_an_upper_structure() -> None:
    for stddev in (0.0, 1.0, math.inf):
        assert load_swung(2.0, stddev, GRAVITY_CENTRE) == load_swung(0.0, 0.0, GRAVITY_CENTRE)


def test_rear_loaded_track_has_more_thrust_at_the_same_small_slip() -> None:
    """The soil at the rear has the largest shear displacement: 1 − 2 x_N/l times the thrust."""
    length, n = VEHICLE.contact_length, 200
    contact = Contact(element_positions(length, n), 0.5 * VEHICLE.tread)
    speed, slip, centre = 0.35, 1e-4, -0.15
    lean = 12.0 * centre / length**2
    j = np.zeros((2, n, 2))
    j[:, :, 0] = -slip * (0.5 * length - contact.x_e)
    pulls = []
    for load_lean in (0.0, lean):
        rolling = Rolling(np.array((speed * (1.0 - slip), 0.0, 0.0)), np.full(2, speed), load_lean)
        q = np.zeros((2, 1))
        no_error = RollingError(np.zeros(2), np.zeros(2), 0.0)
        fill_mobilised_shares(j, rolling, no_error, contact, np.array((0.01,)), q)
        pulls.append(float(q[0, 0]))
    assert pulls[1] / pulls[0] == pytest.approx(1.0 - 2.0 * centre / length, rel=5e-3)
