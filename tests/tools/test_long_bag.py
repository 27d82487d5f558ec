# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A bag of many minutes, made by ``tests/fixtures/long_bag.py``, is processed in bounded memory."""

import subprocess
import sys
from pathlib import Path

import pytest
from fixtures.whole_inputs import read_inputs

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.reader import open_bag
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_tools.replay.run import replay

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
MINUTES = 20
GROWTH = 25.0  # MB per ten minutes; tables of 100 Hz as Python objects would need hundreds
READ = """
import resource, sys
from trackslip_bags.input_filters import InputFilters
from trackslip_bags.reader import open_bag
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_tools.replay.inputs import InputStream

tables = ("odometry", "track_slip", "truth/odometry", "truth/track_slip", "hydraulics")
with open_bag(sys.argv[1]) as bag:
    for _ in InputStream(bag, load_slip_parameters(), InputFilters(stop_s=float(sys.argv[2])), tables):
        pass
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3)
"""

RUN = """
import resource, sys
from trackslip_tools.cli.main import main

code = main(sys.argv[1:])
print(code, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3)
"""
# MB per ten minutes before thinning begins; the limit for 8 h is fifty times as much.
GROWTHS = {"replay": 30.0, "calibrate": 25.0, "smooth": 30.0, "report": 60.0}


def lengthened(path: Path, minutes: float, *options: str) -> Path:
    places = (ROOT / "tests/fixtures/long_bag.py", ROOT / "bags/slalom_sand", path)
    command = [sys.executable, *map(str, places)]
    subprocess.run([*command, "--hours", str(minutes / 60.0), *options], check=True)
    return path


@pytest.mark.timeout(600)
def test_memory_does_not_grow_with_the_length(tmp_path: Path) -> None:
    path = lengthened(tmp_path / "long", MINUTES, "--live")

    def largest(minutes: float) -> float:
        command = [sys.executable, "-c", READ, path, str(60.0 * minutes)]
        return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)

    assert largest(MINUTES) < largest(MINUTES / 2.0) + GROWTH


@pytest.mark.timeout(900)
@pytest.mark.parametrize("command", GROWTHS)
def test_memory_growth_of_commands_is_limited(tmp_path: Path, command: str) -> None:
    """No command stores its inputs as Python objects or as complete message records."""
    options = ["--output", str(tmp_path / "report.html")] if command == "report" else []

    def largest(minutes: float) -> float:
        path = lengthened(tmp_path / f"{minutes:g}", minutes, "--live")
        arguments = [sys.executable, "-c", RUN, command, str(path), *options]
        done = subprocess.run(arguments, capture_output=True, text=True, check=True)
        code, megabytes = done.stdout.splitlines()[-1].split()
        assert int(code) == 0
        return float(megabytes)

    assert largest(MINUTES) < largest(MINUTES / 2.0) + GROWTHS[command]


@pytest.mark.timeout(600)
def test_repeated_drive_is_continuous(tmp_path: Path) -> None:
    """Stamps, sprockets and poses have no jumps, and no message is lost."""
    path = lengthened(tmp_path / "long", 2.0, "--live")
    with open_bag(path) as bag:
        inputs = read_inputs(bag, load_slip_parameters(), InputFilters(), ())
        result = replay(bag, load_slip_parameters(), InputFilters(), None)
    assert (inputs.counts.lost_lines, inputs.counts.lost_inputs) == (0, 0)
    assert inputs.duration_s > 119.0
    assert set(result.rejected.by_source()) <= {"sprockets", "box_pose"}
    assert sum(result.rejected.by_source().get("box_pose", {}).values()) < 5
    scored = result.scores["filter"]
    assert scored is not None
    assert scored.position < 0.1
