# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What a replay states of a whole run: distance, durations, time without fixes, rejections."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fixtures.recorded import Line

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.messages import header, make
from trackslip_bags.reader import open_bag
from trackslip_estimation.slip.measurements import SET_POSE
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.slip.records import ESTIMATE, POSE, RESULT
from trackslip_tools.replay.arrivals import ARRIVAL
from trackslip_tools.replay.run import replay
from trackslip_tools.replay.stuck_tracks import FixGaps
from trackslip_tools.replay.travel import Travel

S = 1_000_000_000
Summary = Callable[..., dict[str, Any]]


def estimates(first_s: float, motion: Motion = Motion.STRAIGHT) -> np.ndarray:
    """One second of ``ESTIMATE`` at 100 Hz and 1 m/s."""
    rows = np.zeros(101, ESTIMATE)
    rows["stamp_ns"] = round(first_s * S) + np.arange(101) * S // 100
    rows["twist"][:, :2], rows["motion"] = (0.6, 0.8), motion
    return rows


@pytest.mark.parametrize("pause_s", [19.0, -5.0])
def test_missing_estimates_are_neither_distance_nor_time(pause_s: float) -> None:
    travel = Travel()
    for first_s in (100.0, 101.0 + pause_s):
        travel.add(estimates(first_s))
    assert travel.distance == pytest.approx(2.0)
    assert travel.seconds[Motion.STRAIGHT] == pytest.approx(2.0)


def test_distance_is_driven_in_motion_only_and_across_parts() -> None:
    travel = Travel()
    for rows in np.array_split(np.concatenate((estimates(1.0), estimates(2.01, Motion.STANDING))), 7):
        travel.add(rows)
    assert travel.distance == pytest.approx(1.0)
    assert travel.seconds[Motion.STANDING] == pytest.approx(1.01)


def manual_pose(lines: list[Line], number: int) -> Line:
    """A manual pose without a stamp, logged just before the line of this number."""
    fix = next(line.message for line in lines if line.topic == "box_pose")
    in_order = sorted(lines, key=lambda line: line.log_ns)
    set_pose = make(fix.__msgtype__, header=header(0, "map"), pose=fix.pose)
    return in_order[number].instead(SET_POSE, set_pose)._replace(log_ns=in_order[number].log_ns - 1)


def test_manual_pose_without_a_stamp_is_a_fix_of_its_time(
    lines: list[Line], bag_of: Callable[..., Path]
) -> None:
    with open_bag(bag_of([*lines, manual_pose(lines, 1000)])) as bag:
        gap = replay(bag, load_slip_parameters(), InputFilters(), None).longest_gap
    assert gap is not None
    assert 0.0 <= gap[0] < gap[1] < 11.0


def test_fix_without_time_after_it_leaves_a_gap_of_no_length_at_its_stamp() -> None:
    gaps, arrivals, results = FixGaps(), np.zeros(1, ARRIVAL), np.zeros(1, RESULT)
    arrivals["kind"], results["stamp_ns"] = POSE, 1002 * S
    gaps.add(arrivals, results)
    assert gaps.longest_gap(1002 * S, 1000 * S) == (2.0, 2.0)


def test_output_of_a_replay_begins_with_its_bag(
    lines: list[Line], bag_of: Callable[..., Path], summary: Summary, tmp_path: Path
) -> None:
    """A manual pose that precedes all measurements has no stamp."""
    path = bag_of([*lines, manual_pose(lines, 0)])
    summary(path, "--output", tmp_path / "out")
    with open_bag(path) as bag, open_bag(tmp_path / "out") as output:
        assert output.start_ns == pytest.approx(bag.start_ns, abs=S)


def test_sample_with_a_jump_of_the_positions_is_not_counted_as_rejected(
    lines: list[Line], bag_of: Callable[..., Path], summary: Summary
) -> None:
    """Its speeds are used."""

    def jumped(line: Line) -> Line:
        if line.topic != "sprockets" or line.log_ns < lines[0].log_ns + 6 * S:
            return line
        m = line.message
        fields = {"header": m.header, "name": m.name, "position": m.position + 90.0, "velocity": m.velocity}
        return line.instead("sprockets", make(m.__msgtype__, **fields))

    counts = summary(bag_of(map(jumped, lines)))["rejected"].get("sprockets", {})
    assert counts.keys() <= {"waiting"}
