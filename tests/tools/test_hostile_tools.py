# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Hostile bags, disks and options, given to ``trackslip``: one line, and no files left behind."""

import shlex
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fixtures.commands import TRACKSLIP
from fixtures.made_bags import write_bag

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.messages import make
from trackslip_bags.reader import open_bag
from trackslip_common.errors import ExitCode
from trackslip_tools.cli.main import main
from trackslip_tools.report.recording import read_recording

Refuse = Callable[..., str]
BagOf = Callable[..., Path]
TEXT = "std_msgs/msg/String"
SOIL = "trackslip_msgs/msg/SoilEstimate"
ESCAPE = "\x1b]0;title\x07"


@pytest.mark.parametrize("topic", ["hydraulics", "soil", "track_forces", "truth/soil"])
def test_wrong_types_of_the_soils_topics(lines: list[Any], bag_of: BagOf, refuse: Refuse, topic: str) -> None:
    hydraulics = make("trackslip_msgs/msg/TrackHydraulics")
    right = lines[0].instead("hydraulics", hydraulics)
    wrong = lines[0].instead(topic, make(TEXT, data="hello"))
    path = bag_of([*lines, wrong, *([right] if topic != "hydraulics" else [])])
    assert f"/{topic} is a {TEXT}" in refuse("replay", path)


def test_class_names_that_change_in_a_bag(tmp_path: Path) -> None:
    classes = [(["a"], [0.5]), ([], []), (["b", "a"], [0.25, 0.75]), (["a", "b"], [1.0]), (["a"], [1.0, 2.0])]
    messages = [("/soil", make(SOIL, class_names=names, class_probabilities=p)) for names, p in classes]
    with open_bag(write_bag(tmp_path / "bag", messages)) as bag:
        found = read_recording(bag, InputFilters()).numbers["soil"].classes
    nan = float("nan")
    np.testing.assert_array_equal(found["a"], [0.5, nan, 0.75, nan, nan])
    np.testing.assert_array_equal(found["b"], [nan, nan, 0.25, nan, nan])


def test_reference_renamed_by_remap_is_refused_with_its_new_name(bag: Path, refuse: Refuse) -> None:
    options = ("--remap", "reference_pose:=other", "--reference", "reference_pose")
    assert "--remap reads it as other; accepted: the name that it has then" in refuse("replay", bag, *options)


def test_escapes_in_names_do_not_reach_the_terminal(
    tmp_path: Path, lines: list[Any], bag_of: BagOf, capsys: pytest.CaptureFixture[str]
) -> None:
    odd = lines[0].instead(ESCAPE, make(TEXT, data=ESCAPE))
    content = f'slip_estimator: {{ros__parameters: {{"{ESCAPE.encode("unicode_escape").decode()}": 1}}}}'
    parameters = odd._replace(topic="slip_estimator/parameters", message=make(TEXT, data=content))
    path = bag_of([parameters, odd, *lines])
    main(["info", str(path)])
    main(["recover", str(path), "--output", str(tmp_path / "recovered")])
    main(["replay", str(path), "--start", "9"])
    main(["replay", str(path), "--withhold", "bocks"])
    main(["replay", str(path), "--reference", ESCAPE])
    shown = capsys.readouterr()
    assert "\\x1b]0;title\\x07" in shown.out
    assert "is not one of this version" in shown.err
    assert all(c.isprintable() or c == "\n" for c in shown.out + shown.err)


def test_a_full_disk_leaves_nothing_of_a_replay(
    bag: Path, tmp_path: Path, refuse: Refuse, request: pytest.FixtureRequest
) -> None:
    request.getfixturevalue("full_disk")
    error = refuse("replay", bag, "--stop", "3", "--output", tmp_path / "estimates")
    assert "cannot be written (No space left on device)" in error
    assert not list(tmp_path.iterdir())


def test_a_full_disk_leaves_nothing_of_an_import(
    tmp_path: Path, refuse: Refuse, request: pytest.FixtureRequest
) -> None:
    log, mapping = tmp_path / "log.csv", tmp_path / "mapping.yaml"
    log.write_text("t,l,r\n" + "".join(f"{k},{np.pi * k},2\n" for k in range(2000)), encoding="utf-8")
    mapping.write_text(
        "topics: {sprockets: {time: {column: t, unit: s}, left_velocity: {column: l, unit: rad/s}, "
        "right_velocity: {column: r, unit: rad/s}}}\n",
        encoding="utf-8",
    )
    request.getfixturevalue("full_disk")
    error = refuse("import", log, "--mapping", mapping, "--output", tmp_path / "bag")
    assert "cannot be written (No space left on device)" in error
    assert sorted(file.name for file in tmp_path.iterdir()) == ["log.csv", "mapping.yaml"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_info_into_a_full_disk_ends_with_one_line(bag: Path) -> None:
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        command = [*TRACKSLIP, "info", str(bag)]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == ExitCode.BAD_INPUT
    assert done.stderr == "trackslip: cannot read or write (No space left on device)\n"


def test_info_with_closed_output_ends_quietly(bag: Path) -> None:
    """``>&-``: the process has no stdout."""
    command = f"{shlex.join([*TRACKSLIP, 'info', str(bag)])} >&-"
    done = subprocess.run(["sh", "-c", command], stderr=subprocess.PIPE, text=True, check=False)
    assert (done.returncode, done.stderr) == (ExitCode.DONE, "")


def test_poses_of_another_frame_are_refused_by_name(
    bag: Path, summary: Callable[..., dict[str, Any]], capsys: pytest.CaptureFixture[str]
) -> None:
    """Fixes of the bag state no frame. If a frame is required, they are rejected and counted, as live."""
    setting = "slip_estimator.sources.box_pose.frame_id="
    every = summary(bag)
    assert every["messages"]["box_pose"] > 0
    assert summary(bag, "--set", f"{setting}''")["rejected"] == every["rejected"]
    refused = summary(bag, "--set", f"{setting}map", code=ExitCode.FAILED)
    assert refused["rejected"]["box_pose"] == {"of another frame": every["messages"]["box_pose"]}
    assert "every fix was rejected (box_pose: " in capsys.readouterr().out
