# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``python -m trackslip_sim.drives.main``: random drives of random machines, held against their bars.

Exit code 1 where a bar is missed.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor

import numpy as np

from trackslip_common.errors import ExitCode
from trackslip_estimation.slip.parameters import SlipEstimatorParameters, load_slip_parameters
from trackslip_sim.drives.drive import random_drive
from trackslip_sim.drives.score import LARGE, Score, score
from trackslip_sim.machine.drawn import DrawnMachine

NEES = (2.0, 4.5)  # of the pose, as a mean over the drives
LONGEST = 5.0  # s above ``LARGE``
DEVIATIONS, INSIDE = 3.0, 11.83  # of a heading; χ² of two numbers with the probability of 3 deviations of one
SHARE = 0.99  # of the ends


def parameters() -> SlipEstimatorParameters:
    """Those of a machine that nobody tuned: its fixes come from a source of which nothing is known."""
    return load_slip_parameters({"pose_sources": ("site_pose",)})


def missed_bars(scores: Sequence[Score]) -> list[str]:
    """What is wrong, in words."""
    nees = float(np.mean([s.nees for s in scores]))
    longest = max(s.longest for s in scores)
    headings = np.concatenate([s.headings for s in scores])
    ends = np.concatenate([s.ends for s in scores])
    found = []
    if not NEES[0] <= nees <= NEES[1]:
        found.append(f"NEES of the pose {nees:.2f}; accepted: {NEES[0]:g} to {NEES[1]:g}")
    if longest > LONGEST:
        found.append(f"NEES above {LARGE:g} for {longest:.1f} s; accepted: {LONGEST:g} s")
    if headings.size and headings.max() > DEVIATIONS:
        found.append(f"heading {headings.max():.1f} σ off after fixes came back; accepted: {DEVIATIONS:g}")
    if ends.size and np.mean(ends <= INSIDE) < SHARE and np.sum(ends > INSIDE) > 1:
        found.append(f"{np.sum(ends > INSIDE)} of {ends.size} ends of silences outside 3 σ; accepted: 1 %")
    return found


def scored(seed: int) -> tuple[str, DrawnMachine, Score]:
    """One drive."""
    p = parameters()
    drive = random_drive(seed, p)
    return drive.soil, drive.machine, score(drive, p)


def row(seed: int, soil: str, m: DrawnMachine, s: Score) -> str:
    """Two lines of the table: errors, the machine that was drawn, and headings and ends over their claims."""
    headings = " ".join(f"{value:.1f}" for value in s.headings)
    ends = " ".join(f"{error:.2f} ({d2:.1f})" for error, d2 in zip(s.end_errors, s.ends, strict=True))
    machine = f"{m.gyro_scale:.3f} {m.asymmetry:+.3f} {m.radius:.3f} × {m.velocity_errors:.1f}"
    machine += f" × {m.gyro_noise:.1f} {m.fix_delay:+.2f}"
    numbers = f"{1e3 * s.position_rmse:6.1f} {s.nees:6.2f} {s.longest:5.1f}"
    return f"{seed:4d} {soil:11s} {numbers}  {machine}\n     heading {headings} σ, ends {ends} m (d²)"


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=40, help="drives (default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="at a time (default: one per core)")
    args = parser.parse_args(argv)
    print("seed soil            mm   NEES  s>30  machine")
    scores = []
    with ProcessPoolExecutor(args.jobs) as pool:
        for seed, found in enumerate(pool.map(scored, range(args.seeds))):
            print(row(seed, *found), flush=True)
            scores.append(found[2])
    ends = np.concatenate([s.ends for s in scores])
    rmse = 1e3 * np.sqrt(np.mean([s.position_rmse**2 for s in scores]))
    nees, refused = np.mean([s.nees for s in scores]), max(s.refused_in_a_row for s in scores)
    print(f"{len(scores)} drives: {rmse:.1f} mm with fixes, NEES {nees:.2f}, {refused} refused in a row")
    print(f"d² {ends.mean():.2f} at {ends.size} ends of silences, {np.sum(ends > INSIDE)} outside 3 σ")
    missed = missed_bars(scores)
    for bar in missed:
        print(f"missed: {bar}")
    return ExitCode.FAILED if missed else ExitCode.DONE


if __name__ == "__main__":
    sys.exit(main())
