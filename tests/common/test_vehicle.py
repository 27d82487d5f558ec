# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Vehicle files: only the kinematics are required, and what is wrong is told in one line."""

from pathlib import Path

import pytest

from trackslip_common.errors import InputError
from trackslip_common.vehicle import (
    ASSUMED,
    GRAVITY,
    load_vehicle,
    vehicle_layer,
    vehicle_names,
    vehicle_of_text,
    vehicle_text,
)
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.soil.soil_estimator import SoilEstimator
from trackslip_estimation.soil.soil_parameters import load_soil_parameters

BARE = "kinematics: {rolling_radius: 0.3, tread: 2.0, contact_length: 3.0}\n"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A vehicle of somebody's own, with what every vehicle must have."""
    path = tmp_path / "digger.yaml"
    path.write_text(BARE, encoding="utf-8")
    return path


@pytest.mark.parametrize("name", vehicle_names())
def test_a_vehicle_survives_the_way_through_its_topic(name: str) -> None:
    vehicle = load_vehicle(name)
    assert vehicle.name == name
    assert vehicle_of_text(vehicle_text(vehicle), "vehicle") == vehicle


def test_kinematics_are_enough_for_pose_and_slips_but_not_for_soil(file: Path) -> None:
    vehicle = load_vehicle(str(file))
    assert (vehicle.name, vehicle.kinematics.tread, vehicle.mass) == ("digger", 2.0, None)
    assert load_slip_parameters({"vehicle": str(file)}).vehicle == vehicle
    lacking = load_soil_parameters({"vehicle": str(file)})
    with pytest.raises(InputError, match=r"^vehicle 'digger' has no mass and no hydraulics; accepted:"):
        SoilEstimator(lacking)
    with pytest.raises(InputError, match=r"^vehicle 'digger' has no sensors\.box for the laser"):
        _ = vehicle.box


def test_a_whole_machine_has_the_numbers_of_its_groups() -> None:
    vehicle = load_vehicle("excavator_20t")
    whole = vehicle.whole()
    assert vehicle.mass is not None
    assert (whole.tread, whole.mass) == (vehicle.kinematics.tread, vehicle.mass.mass)
    assert whole.weight == pytest.approx(21000.0 * GRAVITY)


def test_a_vehicle_that_is_named_replaces_all_of_another_and_its_numbers_may_be_changed(file: Path) -> None:
    p = load_slip_parameters(
        vehicle_layer(load_vehicle("excavator_20t")),
        {"vehicle": str(file), "vehicle.kinematics.tread": 2.1},
        {"vehicle.kinematics.rolling_radius": 0.31},
    )
    assert (p.vehicle.name, p.vehicle.hydraulics) == ("digger", None)
    assert (p.vehicle.kinematics.tread, p.vehicle.kinematics.rolling_radius) == (2.1, 0.31)
    assert load_slip_parameters().vehicle == load_vehicle(ASSUMED)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("kinematics: {rolling_radius: 0.3, tread: 2.0}", "'kinematics.contact_length' is missing"),
        ("mass: {mass: 3}", "'kinematics.rolling_radius' is missing"),
        (BARE + "masss: {mass: 3}", "unknown parameter 'masss.mass', did you mean 'mass'?"),
        (BARE + "mass: {mass: 3}", "parameter 'mass.yaw_inertia' is missing"),
        (BARE + "sensors: {box: {lenght: 1}}", "did you mean 'sensors.box.length'?"),
        (BARE.replace("2.0", "2000"), "kinematics.tread: 2000.0 is out of range; accepted: > 0 and <= 50 m"),
        (BARE.replace("2.0", "wide"), "kinematics.tread: 'wide' is not a number"),
        ("kinematics: 3", "unknown parameter 'kinematics'; accepted: kinematics.rolling_radius"),
        ("[1, 2]", "expected names and values"),
    ],
)
def test_what_is_wrong_with_a_file_is_told_in_one_line(text: str, told: str, file: Path) -> None:
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as refused:
        load_vehicle(str(file))
    assert told in str(refused.value)
    assert str(refused.value).startswith(str(file))
    assert "\n" not in str(refused.value)


def test_an_unknown_vehicle_is_told_with_those_there_are() -> None:
    with pytest.raises(InputError, match=r"^vehicle 'x': no such vehicle or file; accepted: excavator_20t,"):
        load_vehicle("x")
    with pytest.raises(InputError, match=r"did you mean 'pc05'\?$"):
        load_slip_parameters({"vehicle": "pc5"})


def test_a_vehicle_takes_from_its_base_what_it_does_not_say() -> None:
    cab, base = load_vehicle("pc05_cab"), load_vehicle("pc05")
    assert (cab.kinematics, cab.hydraulics) == (base.kinematics, base.hydraulics)
    assert cab.name == "pc05_cab"
    assert cab.mount_of("imu") == "upper"
    assert base.mount_of("imu") == "undercarriage"
    assert vehicle_of_text(vehicle_text(cab), "vehicle") == cab


def test_a_base_with_a_base_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "third.yaml"
    path.write_text("base: pc05_cab\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"third\.yaml: base: 'pc05_cab' has one too; accepted"):
        load_vehicle(str(path))
