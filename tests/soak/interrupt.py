# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Presses Ctrl-C at random moments of set-up, demo, tests, tuning, study; then each must work without help.

    python3 tests/soak/interrupt.py [--times 20] [--seed 1] [--only tune study]

It runs in the checkout that it stands in; use a clone: an interrupted set-up leaves the environment to be
made. Each of the five commands, or of those named, is interrupted TIMES / 5 times, must end within 20 s,
with no traceback of ours, and is then run to its end. The exit code is 1 if anything did not go so.
"""

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TRACKSLIP = str(ROOT / ".venv" / "bin" / "trackslip")
_PYTEST = ".venv/bin/python -m pytest -q -n 2"
PATIENCE_S, LONGEST_S = 20.0, 1800.0
# What is run, and until when the interruption comes at the latest, s.
COMMANDS: dict[str, tuple[Sequence[str], float]] = {
    "setup": (("make", "setup"), 120.0),
    "demo": (("make", "demo", "DURATION=5"), 30.0),
    "test": (("sh", "-c", f"make checks && exec {_PYTEST} tests/common"), 40.0),
    "tune": (
        (
            TRACKSLIP,
            "tune",
            "bags/slalom_sand",
            "--plan",
            "out/interrupt/plan.yaml",
            "--output",
            "out/interrupt/tuned",
        ),
        4.0,
    ),
    "study": ((TRACKSLIP, "study", "--soil", "sand", "--filter", "ekf", "--seeds", "20"), 15.0),
}
PLAN = """\
objective: likelihood
evaluations: 1000
seed: 0
parameters:
  turning.loss: {low: 0.001, high: 0.1, scale: log}
"""


def main() -> int:
    """Interrupt, then run all; the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--times", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", nargs="+", choices=COMMANDS, default=list(COMMANDS))
    args = parser.parse_args()
    draw = random.Random(args.seed)
    plan = ROOT / "out" / "interrupt" / "plan.yaml"
    plan.parent.mkdir(parents=True, exist_ok=True)
    plan.write_text(PLAN, encoding="utf-8")
    fine, each = True, max(args.times // len(COMMANDS), 1)
    for name in args.only:
        for number in range(each):
            fine &= _interrupted(number, name, draw.uniform(0.1, COMMANDS[name][1]))
        fine &= _whole(name)
    return 0 if fine else 1


def _interrupted(number: int, name: str, after_s: float) -> bool:
    """Whether a command ended as it should when it was interrupted."""
    with tempfile.TemporaryFile("w+") as output:
        process = _started(name, output.fileno())
        try:
            process.wait(after_s)
            said, fine = "had ended before", process.returncode == 0
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGINT)  # as a terminal does
            began = time.monotonic()
            fine = True
            try:
                process.wait(PATIENCE_S)
            except subprocess.TimeoutExpired:
                fine = False
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
            said = f"ended {time.monotonic() - began:.1f} s later with {process.returncode}"
        output.seek(0)
        text = output.read()
    if "Traceback" in text and name != "test":  # pytest shows where it was
        fine = False
    print(
        f"{number + 1:>3} {name:<6} after {after_s:5.1f} s: {said}{'' if fine else ' NOT FINE'}", flush=True
    )
    if not fine:
        print(text[-3000:], flush=True)
    return fine


def _whole(name: str) -> bool:
    """Whether a command does its work without help."""
    with tempfile.TemporaryFile("w+") as output:
        code = _started(name, output.fileno()).wait(LONGEST_S)
        output.seek(0)
        text = output.read()
    print(f"    {name:<6} to its end: exit code {code}", flush=True)
    missed = code == 2 and "missed: " in text  # a check of the demo's own, on a busy machine
    if code and not missed and (name, code) != ("tune", 1):  # 1: found nothing better
        print(text[-3000:], flush=True)
        return False
    return True


def _started(name: str, output: int) -> "subprocess.Popen[bytes]":
    """In a process group of its own, which listens to Ctrl-C."""
    return subprocess.Popen(
        COMMANDS[name][0],
        cwd=ROOT,
        env={**os.environ, "XDG_CACHE_HOME": str(ROOT / "out" / "interrupt")},
        stdin=subprocess.DEVNULL,
        stdout=output,
        stderr=output,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )


if __name__ == "__main__":
    sys.exit(main())
