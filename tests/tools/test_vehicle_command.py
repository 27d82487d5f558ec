# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip vehicle new``: files that load, plausible numbers, and guessed values marked as such."""

import math
from pathlib import Path

import pytest

from trackslip_common.config_files import config_file, node_parameters, read_yaml
from trackslip_common.errors import ExitCode, InputError
from trackslip_common.parameters import flat_fields
from trackslip_common.vehicle import Kinematics
from trackslip_common.vehicle_files import load_vehicle, vehicle_layer
from trackslip_estimation.slip.parameters import SlipEstimatorParameters, load_slip_parameters
from trackslip_estimation.slip.sources import HeadingSource, PoseSource, YawRateSource
from trackslip_tools.cli.main import main
from trackslip_tools.machine.draft import draft_vehicle

MOST_BASIC = 15


def new(tmp_path: Path, *arguments: str) -> int:
    return main(
        ["vehicle", "new", "--name", "digger", "--output", str(tmp_path), "--no-questions", *arguments]
    )


def test_file_loads_and_its_receiver_is_the_source_of_poses(tmp_path: Path) -> None:
    assert new(tmp_path, "--mass", "20000", "--tread", "2.4") == ExitCode.DONE
    vehicle = load_vehicle(str(tmp_path / "digger.yaml"))
    assert (vehicle.name, vehicle.kinematics.tread) == ("digger", 2.4)
    assert vehicle.missing_groups_message == "vehicle 'digger' has no hydraulics"
    p = load_slip_parameters(vehicle_layer(vehicle))
    assert p.pose_sources == ("gnss_pose",)
    x, y, z = p.poses()["gnss_pose"].lever
    assert (x, y) == (0.0, 0.0)  # between the tracks
    assert z > 1.0
    assert not p.poses()["gnss_pose"].use_heading


def test_stated_pose_sources_override_those_of_the_vehicle(tmp_path: Path) -> None:
    new(tmp_path, "--mass", "20000")
    layer = vehicle_layer(load_vehicle(str(tmp_path / "digger.yaml")))
    assert load_slip_parameters({"pose_sources": ["rtk"]}, layer).pose_sources == ("rtk",)
    assert load_slip_parameters(layer, {"pose_sources": ["rtk"]}).pose_sources == ("rtk",)
    assert load_slip_parameters({**layer, "pose_sources": ["box_pose"]}).pose_sources == ("box_pose",)


def test_machine_with_a_box_keeps_the_laser() -> None:
    assert load_slip_parameters(vehicle_layer(load_vehicle("excavator_20t"))).pose_sources == ("box_pose",)


@pytest.mark.parametrize("name", ["pc05", "excavator_20t"])
def test_guesses_from_the_mass_cover_machines_that_are_known(name: str) -> None:
    vehicle = load_vehicle(name)
    assert vehicle.mass is not None
    draft = draft_vehicle("guessed", {"mass.mass": vehicle.mass.mass})
    for number in ("rolling_radius", "tread", "contact_length"):
        share = draft.guessed[f"kinematics.{number}"]
        ratio = getattr(draft.vehicle.kinematics, number) / getattr(vehicle.kinematics, number)
        assert abs(math.log(ratio)) < 1.5 * share


def test_guessed_radius_widens_the_prior_of_the_slip(tmp_path: Path) -> None:
    new(tmp_path, "--mass", "20000")
    values = node_parameters(read_yaml(tmp_path / "digger_estimator.yaml"), "slip_estimator", "file")
    layer = vehicle_layer(load_vehicle(str(tmp_path / "digger.yaml")))
    before, after = load_slip_parameters(layer), load_slip_parameters(layer, values)
    assert after.turning.initial_common_slip_stddev > 3.0 * before.turning.initial_common_slip_stddev


def test_measured_radius_needs_no_other_parameters(tmp_path: Path) -> None:
    new(tmp_path, "--mass", "20000", "--rolling-radius", "0.36")
    assert [path.name for path in tmp_path.iterdir()] == ["digger.yaml"]


def test_kinematics_alone_are_enough(tmp_path: Path) -> None:
    options = ("--rolling-radius", "0.36", "--tread", "2.4", "--contact-length", "3.4")
    assert new(tmp_path, *options, "--antenna", "-1.2", "0.6", "3.0") == ExitCode.DONE
    vehicle = load_vehicle(str(tmp_path / "digger.yaml"))
    assert vehicle.mass is None
    assert vehicle.sensors is not None
    assert vehicle.sensors.antenna is not None
    assert vehicle.sensors.antenna.y == 0.6


def test_existing_file_is_not_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "digger.yaml").write_text("mine", encoding="utf-8")
    assert new(tmp_path, "--mass", "20000") == ExitCode.BAD_INPUT
    assert (tmp_path / "digger.yaml").read_text(encoding="utf-8") == "mine"
    assert "accepted: another --name or --output" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--tread", "2.4"), "--mass, or all of --rolling-radius, --contact-length"),
        (("--mass", "2e9"), "mass"),
        (("--mass", "20000", "--tread", "-1"), "tread"),
    ],
)
def test_too_few_or_impossible_numbers_are_refused(
    arguments: tuple[str, ...], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert new(tmp_path, *arguments) == ExitCode.BAD_INPUT
    assert words in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("mass", "implausible"), [("20", True), ("20000", False), ("700", False)])
def test_a_mass_in_tons_is_named(
    mass: str, implausible: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert new(tmp_path, "--mass", mass, "--tread", "2.4") == ExitCode.DONE
    assert ("implausible: kinematics.tread 2.4 m" in capsys.readouterr().out) == implausible


@pytest.mark.parametrize("answered", [("18000", "much", "0.4", "", ""), ("18000", "0.4")])
def test_requested_values_are_used_until_ctrl_d(
    answered: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = list(answered)

    def ask(_: str) -> str:
        if not answers:
            raise EOFError
        return answers.pop(0)

    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("builtins.input", ask)
    assert main(["vehicle", "new", "--name", "digger", "--output", str(tmp_path)]) == ExitCode.DONE
    vehicle = load_vehicle(str(tmp_path / "digger.yaml"))
    assert vehicle.mass is not None
    assert (vehicle.mass.mass, vehicle.kinematics.rolling_radius) == (18000.0, 0.4)


def test_list_names_the_vehicles_of_config(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["vehicle", "list"]) == ExitCode.DONE
    names = capsys.readouterr().out.split()
    assert names == [path.stem for path in sorted(config_file("vehicles/pc05.yaml").parent.glob("*.yaml"))]


def test_basic_parameters_are_few() -> None:
    kinds = (Kinematics, SlipEstimatorParameters, PoseSource, YawRateSource, HeadingSource)
    fields = [(name, spec) for kind in kinds for name, _, spec in flat_fields(kind) if spec.basic]
    basic = {(name.rpartition(".")[2], spec.description) for name, spec in fields}
    assert 10 <= len(basic) <= MOST_BASIC


def test_unknown_number_of_a_draft_is_refused() -> None:
    with pytest.raises(InputError, match="nothing"):
        draft_vehicle("made", {"mass.mass": 20000.0, "kinematics.nothing": 1.0})
