# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Gives hostile files to every reader of user files: part of ``make fuzz``.

Each file is read in a process of its own. The reader may use it, or reject it by ``InputError``. A finding
is any other exception, a control character in the output, more than ten seconds of a processor, or more
than 1.5 GB: then the file is kept in ``out/hostile/<reader>/``, and the exit code is 1. The exit code is 1
too where a valid file is rejected, because its mutations then do not reach the code behind the check. To
read a hostile file again:
``.venv/bin/python tests/fuzz/hostile_files.py --reader scenario out/hostile/scenario/7.yaml``.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

from child import run_in_child
from hostile_bags import READERS_OF_BAGS
from hostile_devices import READERS_OF_DEVICES
from hostile_readers import READERS_OF_TEXTS
from hostile_text import hostile
from trackslip_common.errors import ExitCode

ROOT = Path(__file__).resolve().parents[2]
OUT = ROOT / "out" / "hostile"
READERS = READERS_OF_TEXTS | READERS_OF_BAGS | READERS_OF_DEVICES
FILES = 500
LONGEST_S = 10
MOST_MB = 1500


def main() -> int:
    """Run all readers, or one; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--files", type=int, default=FILES, help="for each reader (%(default)s)")
    parser.add_argument("--reader", choices=READERS, help="this one alone, in this process")
    parser.add_argument("cases", nargs="*", type=Path, metavar="FILE", help="with --reader: these instead")
    args = parser.parse_args()
    if args.files < 1 or (args.cases and not args.reader):
        print("hostile_files: accepted: --files 1 or more; FILE with --reader", file=sys.stderr)
        return 2
    if args.reader:
        return _work(args.reader, args.files, args.cases)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        clean = list(pool.map(lambda name: _report(name, args.files), READERS))
    return 0 if all(clean) else 1


def _report(name: str, files: int) -> bool:
    """Run one reader in a process, print a line about it; return whether nothing was found."""
    shutil.rmtree(OUT / name, ignore_errors=True)
    (OUT / name).mkdir(parents=True)
    began = time.monotonic()
    with (OUT / name / "log").open("wb") as log:
        command = [sys.executable, __file__, "--reader", name, "--files", str(files)]
        done = subprocess.run(command, stdout=log, stderr=log, check=False)
    words = (OUT / name / "log").read_text(errors="replace").strip().splitlines() or [""]
    verdict = words[-1] if done.returncode == 0 else f"FOUND: {OUT / name / 'log'}"
    print(f"{name:<12} {time.monotonic() - began:>5.0f} s  {verdict}", flush=True)
    return done.returncode == 0


def _work(name: str, files: int, cases: list[Path]) -> int:
    """Read all files of one reader; the last line of the output is the count."""
    folder = Path(tempfile.mkdtemp(prefix="trackslip_hostile_"))
    os.chdir(folder)
    try:
        reader = READERS[name](folder)
        path = folder / f"case{reader.suffix}"
        for number, seed in enumerate(reader.seeds):
            path.write_bytes(seed)
            ended = run_in_child(partial(reader.read, path), folder, LONGEST_S)
            if ended.code not in (ExitCode.DONE, ExitCode.FAILED):
                print(f"seed {number} is refused, so files made from it test nothing: {ended.err}")
                return 1
        originals = [*reader.seeds, *reader.bombs]
        contents = [case.read_bytes() for case in cases] or (hostile(originals, k) for k in range(files))
        refused, found, slowest, largest = 0, 0, 0.0, 0
        for number, content in enumerate(contents):
            path.write_bytes(content)
            ended = run_in_child(partial(reader.read, path), folder, LONGEST_S)
            slowest, largest = max(slowest, ended.seconds), max(largest, ended.megabytes)
            refused += ended.code == ExitCode.BAD_INPUT
            if problem := ended.problem(LONGEST_S, MOST_MB):
                found += 1
                print(f"{number}: {problem}", flush=True)
                if not cases:
                    (OUT / name).mkdir(parents=True, exist_ok=True)
                    (OUT / name / f"{number}{reader.suffix}").write_bytes(content)
        print(f"{number + 1} files, {refused} refused, {found} found, slowest {slowest:.1f} s, {largest} MB")
        return int(found > 0)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    sys.exit(main())
