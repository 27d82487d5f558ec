# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Settings with the names of an earlier version, for the sources that the bag names."""

from pathlib import Path

import pytest

from trackslip_bags.reader import open_bag
from trackslip_tools.cli.replay_options import parameters_of


@pytest.mark.parametrize("by", ["set", "params"])
def test_names_of_an_earlier_version_are_those_of_the_sources(
    by: str, emulated_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "old.yaml"
    file.write_text("slip_estimator: {ros__parameters: {pose_stamp_errors: [0.02], vehicle: {tread: 0.8}}}")
    settings = ["slip_estimator.pose_stamp_errors=[0.02]", "slip_estimator.vehicle.tread=0.8"]
    with open_bag(emulated_bag) as bag:
        given = ([], settings) if by == "set" else ([str(file)], [])
        p = parameters_of(bag, *given)
    assert p.poses()["box_pose"].stamp_error == 0.02
    assert p.vehicle.kinematics.tread == 0.8
    assert "names of an earlier version" in capsys.readouterr().err
