# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Vehicle files: only the kinematics are required, and each error is one line."""

import re
from pathlib import Path

import pytest

from trackslip_common.config_files import config_directory
from trackslip_common.errors import InputError
from trackslip_common.parameters import to_flat
from trackslip_common.units import GRAVITY
from trackslip_common.vehicle_files import (
    DEFAULT_VEHICLE,
    load_vehicle,
    make_vehicle,
    parse_vehicle,
    vehicle_layer,
    vehicle_names,
    vehicle_text,
)
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.soil.soil_estimator import SoilEstimator
from trackslip_estimation.soil.soil_parameters import load_soil_parameters

BARE = "kinematics: {rolling_radius: 0.3, tread: 2.0, contact_length: 3.0}\n"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A vehicle file with the required values only."""
    path = tmp_path / "digger.yaml"
    path.write_text(BARE, encoding="utf-8")
    return path


@pytest.mark.parametrize("name", vehicle_names())
def test_vehicle_is_unchanged_by_its_topic(name: str) -> None:
    vehicle = load_vehicle(name)
    assert vehicle.name == name
    assert parse_vehicle(vehicle_text(vehicle), "vehicle") == vehicle


def test_kinematics_are_enough_for_pose_and_slips_but_not_for_soil(file: Path) -> None:
    vehicle = load_vehicle(str(file))
    assert (vehicle.name, vehicle.kinematics.tread, vehicle.mass) == ("digger", 2.0, None)
    assert load_slip_parameters({"vehicle": str(file)}).vehicle == vehicle
    parameters = load_soil_parameters({"vehicle": str(file)})
    with pytest.raises(InputError, match=r"^vehicle 'digger' has no mass and no hydraulics; accepted:"):
        SoilEstimator(parameters)
    with pytest.raises(InputError, match=r"^vehicle 'digger' has no sensors\.box for the laser"):
        _ = vehicle.box


def test_a_whole_machine_has_the_numbers_of_its_groups() -> None:
    vehicle = load_vehicle("excavator_20t")
    whole = vehicle.whole()
    assert vehicle.mass is not None
    assert (whole.tread, whole.mass) == (vehicle.kinematics.tread, vehicle.mass.mass)
    assert whole.weight == pytest.approx(21000.0 * GRAVITY)


def test_named_vehicle_replaces_another_and_single_numbers_override_it(file: Path) -> None:
    p = load_slip_parameters(
        vehicle_layer(load_vehicle("excavator_20t")),
        {"vehicle": str(file), "vehicle.kinematics.tread": 2.1},
        {"vehicle.kinematics.rolling_radius": 0.31},
    )
    assert (p.vehicle.name, p.vehicle.hydraulics) == ("digger", None)
    assert (p.vehicle.kinematics.tread, p.vehicle.kinematics.rolling_radius) == (2.1, 0.31)
    assert load_slip_parameters().vehicle == load_vehicle(DEFAULT_VEHICLE)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("kinematics: {rolling_radius: 0.3, tread: 2.0}", "'kinematics.contact_length' is missing"),
        ("mass: {mass: 3}", "'kinematics.rolling_radius' is missing"),
        (BARE + "masss: {mass: 3}", "unknown parameter 'masss.mass', did you mean 'mass'?"),
        (BARE + "mass: {mass: 3000}", "parameter 'mass.yaw_inertia' is missing"),
        (BARE + "sensors: {box: {lenght: 1}}", "did you mean 'sensors.box.length'?"),
        (
            BARE.replace("2.0", "2000"),
            "kinematics.tread: 2000.0 is out of range; accepted: >= 0.02 and <= 20 m",
        ),
        (BARE.replace("2.0", "wide"), "kinematics.tread: 'wide' is not a number"),
        ("kinematics: 3", "unknown parameter 'kinematics'; accepted: kinematics.rolling_radius"),
        ("[1, 2]", "expected names and values"),
    ],
)
def test_the_fault_of_a_file_is_one_line(text: str, sentence: str, file: Path) -> None:
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as refused:
        load_vehicle(str(file))
    assert sentence in str(refused.value)
    assert str(refused.value).startswith(str(file))
    assert "\n" not in str(refused.value)


def test_an_unknown_vehicle_is_refused_with_the_known_ones() -> None:
    with pytest.raises(InputError, match=r"^vehicle 'x': no such vehicle or file; accepted: excavator_20t,"):
        load_vehicle("x")
    with pytest.raises(InputError, match=r"did you mean 'pc05'\?$"):
        load_slip_parameters({"vehicle": "pc5"})


def test_vehicle_inherits_unspecified_values_from_its_base() -> None:
    cab, base = load_vehicle("pc05_cab"), load_vehicle("pc05")
    assert (cab.kinematics, cab.hydraulics) == (base.kinematics, base.hydraulics)
    assert cab.name == "pc05_cab"
    assert cab.mount_of("imu") == "upper"
    assert base.mount_of("imu") == "undercarriage"


def test_a_base_with_a_base_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "third.yaml"
    path.write_text("base: pc05_cab\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"third\.yaml: base: 'pc05_cab' has one too; accepted"):
        load_vehicle(str(path))


@pytest.mark.parametrize(("own", "name"), [("", "antenna_aft"), ("name: digger seven\n", "digger seven")])
def test_variant_is_named_after_its_file_or_its_own_name(own: str, name: str, tmp_path: Path) -> None:
    path = tmp_path / "antenna_aft.yaml"
    path.write_text(f"base: excavator_20t\n{own}sensors: {{antenna: {{x: -2.0}}}}\n", encoding="utf-8")
    variant, base = load_vehicle(str(path)), load_vehicle("excavator_20t")
    assert (variant.name, base.name) == (name, "excavator_20t")
    assert (variant.mass, variant.hydraulics) == (base.mass, base.hydraulics)
    assert parse_vehicle(vehicle_text(variant), "vehicle").name == name
    assert load_slip_parameters({"vehicle": str(path)}).vehicle.name == name


_WHOLE = """kinematics: {rolling_radius: 0.35, tread: 2.38, contact_length: 3.46}
mass: {mass: 21000.0, yaw_inertia: 50000.0, track_width: 0.6}
hydraulics: {motor_displacement: 160.0e-6, gear_ratio: 46.0, motor_efficiency: 0.8,
  volumetric_efficiency: 0.93, relief_pressure: 34.0e+6, pump_flow: 3.5e-3}
upper_structure: {mass: 13500.0, swing_axis_x: 0.1, swing_axis_y: 0.0, centre_x: 0.2,
  drive: {rate: 1.2, acceleration: 0.8, backlash: 0.003}}
sensors: {antenna: {x: -1.2, y: 0.6, z: 3.0}}
"""


@pytest.mark.parametrize(
    ("si", "other", "words"),
    [
        ("{mass: 21000.0", "{mass: 21.0", "ground pressure of 0.0496 kPa; accepted: 0.5 to 500 kPa, by"),
        ("50000.0", "50.0", "contact length of 0.0141; accepted: 0.1 to 3, by mass.yaw_inertia (kg m²)"),
        ("34.0e+6", "340.0", "relief_pressure: 340.0 is out of range; accepted: >= 1e+06 and <= 1e+08 Pa"),
        ("160.0e-6", "0.016", "top speed of 0.00973 m/s; accepted: 0.01 to 30 m/s, by hydraulics"),
        (
            "motor_efficiency: 0.8",
            "motor_efficiency: 0.01",
            "thrust over weight of 0.0111; accepted: 0.03 to 30",
        ),
        ("0.35, tread: 2.38", "1.9, tread: 0.35", "over contact length of 0.549; accepted: 0.01 to 0.5"),
        ("2.38", "0.3", "contact length over tread of 11.5; accepted: 0.1 to 10"),
        ("13500.0", "22000.0", "share of the mass that swings of 1.05; accepted: 0.01 to 1"),
    ],
)
def test_numbers_in_other_units_are_refused(si: str, other: str, words: str, file: Path) -> None:
    file.write_text(_WHOLE, encoding="utf-8")
    load_vehicle(str(file))
    file.write_text(_WHOLE.replace(si, other, 1), encoding="utf-8")
    with pytest.raises(InputError) as refused:
        load_vehicle(str(file))
    assert words in str(refused.value)
    assert str(refused.value).startswith(f"{file}: ")


def test_each_number_a_thousand_times_too_large_is_refused() -> None:
    """As of millimetres, grams or kilopascals; each is named."""
    numbers = to_flat(parse_vehicle(_WHOLE, "file"))
    for name, value in numbers.items():
        if isinstance(value, float) and value != 0.0:
            with pytest.raises(InputError, match=name.rpartition(".")[2]):
                make_vehicle("x", numbers | {name: 1e3 * value}, "file")


def test_inconsistent_vehicle_is_refused_among_the_parameters_of_a_node() -> None:
    with pytest.raises(InputError, match="rolling radius over contact length"):
        load_slip_parameters({"vehicle": "excavator_20t", "vehicle.kinematics.rolling_radius": 1.9})


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("rolling_radius: 0.35\n", "kinematics.rolling_radius"),
        ("vehicle: {kinematics: {tread: 2.0}}\n", "kinematics.tread"),
        ("/**: {ros__parameters: {kinematics: {tread: 2.0}}}\n", "kinematics.tread"),
    ],
)
def test_number_in_another_group_is_refused_with_its_group(text: str, meant: str, file: Path) -> None:
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=rf"unknown parameter '.*', did you mean '{meant}'\?$"):
        load_vehicle(str(file))


_SIZED = (
    *("kinematics.rolling_radius", "kinematics.tread", "kinematics.contact_length"),
    *("mass.mass", "mass.yaw_inertia", "mass.track_width", "hydraulics.motor_displacement"),
    *("hydraulics.gear_ratio", "hydraulics.relief_pressure", "hydraulics.pump_flow", "upper_structure.mass"),
)
_SIZES = {
    "robot of 17 kg": (0.05, 0.38, 0.4, 17.0, 0.6, 0.08, 1e-6, 10.0, 5e6, 1e-5, 2.0),
    "robot of 100 kg": (0.08, 0.5, 0.6, 100.0, 8.0, 0.12, 8e-6, 10.0, 16e6, 5e-5, 30.0),
    "snow groomer": (0.35, 3.2, 4.5, 9500.0, 4e4, 1.6, 160e-6, 60.0, 42e6, 6e-3, 3000.0),
    "excavator of 100 t": (0.58, 3.9, 5.1, 1e5, 7e5, 0.75, 350e-6, 130.0, 35e6, 8e-3, 6.5e4),
    "mining shovel": (1.2, 6.4, 8.2, 9.8e5, 3e7, 1.8, 1e-3, 400.0, 36e6, 0.03, 7e5),
}


@pytest.mark.parametrize("numbers", _SIZES.values(), ids=_SIZES)
def test_a_machine_of_any_size_is_accepted(numbers: tuple[float, ...]) -> None:
    sized = dict(zip(_SIZED, numbers, strict=True))
    whole = make_vehicle("x", to_flat(parse_vehicle(_WHOLE, "file")) | sized, "file").whole()
    assert whole.mass == sized["mass.mass"]


@pytest.mark.parametrize("name", vehicle_names())
def test_each_number_of_a_vehicle_file_is_explained(name: str) -> None:
    lines = (config_directory() / "vehicles" / f"{name}.yaml").read_text(encoding="utf-8").splitlines()
    above: dict[int, bool] = {}  # indent → whether the group or its comment states it
    bare, explained = [], False
    for line in lines:
        value, _, comment = line.partition("#")
        indent = len(line) - len(line.lstrip())
        states = len(comment.split()) > 1  # more than a unit
        if not value.strip():
            explained = explained or states
            continue
        explained = explained or states or any(known for depth, known in above.items() if depth < indent)
        if re.search(r": *(-?\d|\{.*\d)", value):
            bare += [] if explained else [line]
        else:
            above = {depth: known for depth, known in above.items() if depth < indent} | {indent: explained}
        explained = False
    assert bare == []
