# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Diagnostics of a driving graph name a set-up mistake, and clear it once it is corrected."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import yaml
from fixtures.drives_in_sight import to_and_fro
from fixtures.observer import Observer
from fixtures.programs import Programs

from trackslip_common.config_files import config_file

pytestmark = [pytest.mark.xdist_group("graph"), pytest.mark.soak, pytest.mark.timeout(1200)]

DRIVE_S = 600.0  # longer than a test
PATIENT_S = 600.0  # for a busy host; prints the time used: the goals are 120 s of driving, and 60 s
WARN = b"\1"
ROLES = "can_roles.yaml"

Roles = dict[str, Any]
Values = dict[str, Any]


class Mistake(NamedTuple):
    """A node with a wrong parameter, and its right value."""

    executable: str
    cause: str
    wrong: Callable[[Path], Values]  # writes the needed files into a folder
    right: Values


def _with_roles(change: Callable[[Roles], Roles]) -> Callable[[Path], Values]:
    """Writer of a copy of the roles file with changed roles."""

    def write(folder: Path) -> Values:
        tree = yaml.safe_load(config_file(ROLES).read_text(encoding="utf-8"))
        tree["roles"] |= change(tree["roles"])
        file = folder / "wrong_roles.yaml"
        file.write_text(yaml.safe_dump(tree), encoding="utf-8")
        return {"roles_file": str(file)}

    return write


def _swapped(roles: Roles) -> Roles:
    return {"left_position": roles["right_position"], "right_position": roles["left_position"]}


def _left_reversed(roles: Roles) -> Roles:
    return {"left_position": {**roles["left_position"], "sign": -1}}


MISTAKES = {
    "tracks swapped": Mistake("can_driver", "tracks_swapped", _with_roles(_swapped), {}),
    "left encoder reversed": Mistake("can_driver", "left_track_sign", _with_roles(_left_reversed), {}),
    "gyro flipped": Mistake(
        "slip_estimator",
        "gyro_sign",
        lambda _: {"sources.imu_data_raw.sign": -1},
        {"sources.imu_data_raw.sign": 1},
    ),
}


@pytest.mark.parametrize("name", list(MISTAKES))
def test_setup_mistake_is_reported_and_cleared_once_corrected(
    programs: Programs, observer: Observer, can: Values, name: str
) -> None:
    mistake = MISTAKES[name]
    devices, drive = programs.folder / "devices", programs.folder / "to_and_fro.yaml"
    drive.write_text(to_and_fro("sand"), encoding="utf-8")
    nodes: dict[str, Values] = {
        "can_driver": dict(can),
        "watson_imu": {"serial_port": str(devices / "watson")},
        "sick_pls": {"serial_port": str(devices / "sick")},
        "box_localizer": {},
        "slip_estimator": {},
    }
    nodes[mistake.executable] |= mistake.wrong(programs.folder)
    programs.node("emulator", scenario=str(drive), duration=DRIVE_S, device_directory=str(devices), **can)
    observer.wait(lambda: (devices / "sick").exists(), "the devices", PATIENT_S)
    running = {node: programs.node(node, **parameters) for node, parameters in nodes.items()}
    healths = observer.healths()

    def setup() -> list[Any]:
        return [health for health in healths if health.name == "slip_estimator: setup"]

    observer.wait(setup, "the estimator", PATIENT_S)
    began = time.monotonic()
    observer.wait(lambda: any(health.level == WARN for health in setup()), "the cause", PATIENT_S)
    print(f"{name}: named after {time.monotonic() - began:.0f} s", flush=True)
    named = next(health for health in setup() if health.level == WARN)
    assert named.message.startswith(mistake.cause), named.message

    running[mistake.executable].end()
    corrected = {key: value for key, value in nodes[mistake.executable].items() if key != "roles_file"}
    programs.node(mistake.executable, **{**corrected, **mistake.right})
    began = time.monotonic()

    def is_well() -> bool:
        healths[:] = setup()[-1:]
        return any(health.level != WARN for health in healths)

    observer.wait(is_well, "the cause to go", PATIENT_S)
    print(f"{name}: gone after {time.monotonic() - began:.0f} s", flush=True)
