# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Feeds every parser of foreign bytes with inputs that atheris (libFuzzer) breeds by coverage: ``make fuzz``.

Each target of the other ``fuzz_….py`` runs in a process of its own, as many at a time as there are cores.
What an input must not do there (raise, hold bytes, lose the second frame after garbage) is an
exception; atheris then keeps the input as ``out/fuzz/<target>/crash-…``, and the exit code is 1. To see a
finding again: ``.venv/bin/python scripts/fuzz.py --target sick_session out/fuzz/sick_session/crash-…``.
"""

import argparse
import importlib
import importlib.util
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "out" / "fuzz"
REQUIREMENTS = ROOT / "requirements" / "fuzz.txt"
RUNS = 1_000_000
MEMORY_MB = 600  # of a whole target; interpreter, numpy and the decoders of bags take a third of it
SECONDS_PER_INPUT = 10  # of processor time
HANGS_AFTER = 600  # s of libFuzzer's own clock, which runs on while others have the processor


class Target(NamedTuple):
    """One parser, or several that belong together."""

    module: str
    share: int = 1  # of so many inputs for the byte parsers it gets one
    longest: int = 96  # bytes of an input


TARGETS = {
    "sick_session": Target("fuzz_serial", longest=64),
    "sick_telegrams": Target("fuzz_serial", longest=96),
    "sick_device": Target("fuzz_serial"),
    "watson_lines": Target("fuzz_serial"),
    "watson_frames": Target("fuzz_serial"),
    "nmea_sentences": Target("fuzz_serial", longest=160),
    "ubx_messages": Target("fuzz_serial", longest=400),
    "can_frames": Target("fuzz_can"),
    "bag_files": Target("fuzz_files", share=50, longest=4096),
    "recovered_bags": Target("fuzz_files", share=50, longest=4096),
    "log_files": Target("fuzz_files", share=50, longest=1024),
    "replay_options": Target("fuzz_options", share=10),
}
# What is fuzzed; the rest of the code runs at full speed.
INSTRUMENTED = [
    "trackslip_common.config_files",
    "trackslip_common.parameters",
    "trackslip_drivers.protocols",
    "trackslip_sim.devices",
    "trackslip_bags",
    "trackslip_tools.cli",
    "trackslip_tools.replay",
]
NOT_INSTRUMENTED = [
    "trackslip_drivers.protocols.sick_crc",  # no branch to learn
    "trackslip_drivers.protocols.sick_scan",  # atheris 3.0 leaks arrays that it sees compared
]


def main() -> int:
    """Run all targets; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, help=f"inputs per byte parser ({RUNS}; with --target, no end)")
    parser.add_argument("--target", choices=TARGETS, help="this one alone, in this process")
    arguments, options = parser.parse_known_args()  # the others are libFuzzer's, or inputs, with --target
    if options and not arguments.target:
        parser.error(f"unknown: {' '.join(options)}")
    runs = RUNS if arguments.runs is None else arguments.runs
    if runs < 1:
        print(f"fuzz: RUNS: {runs} is out of range; accepted: 1 or more", file=sys.stderr)
        return 2
    if not atheris_is_there():
        version = f"{sys.version_info.major}.{sys.version_info.minor}"
        print(f"fuzz: no wheel of atheris for Python {version} here (see {REQUIREMENTS})", file=sys.stderr)
        return 2
    if arguments.target:
        fuzz(arguments.target, options if arguments.runs is None else [f"-runs={runs}", *options])
        return 0
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        clean = list(pool.map(lambda target: report(target, runs), TARGETS))
    return 0 if all(clean) else 1


def atheris_is_there() -> bool:
    """Whether it can be imported, once pip has had a try."""
    if importlib.util.find_spec("atheris") is None:
        pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        command = [*pip, "--only-binary=:all:", f"--requirement={REQUIREMENTS}"]
        subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False)
        importlib.invalidate_caches()
    return importlib.util.find_spec("atheris") is not None


def report(target: str, runs: int) -> bool:
    """One target in a process of its own, one line about it; whether it found nothing."""
    directory = OUT / target
    shutil.rmtree(directory, ignore_errors=True)
    (directory / "corpus").mkdir(parents=True)
    wanted = max(1, runs // TARGETS[target].share)
    options = [
        f"-runs={wanted}",
        "-seed=1",
        f"-max_len={TARGETS[target].longest}",
        "-print_final_stats=1",
        "-verbosity=1",
    ]
    limits = [f"-rss_limit_mb={MEMORY_MB}", f"-timeout={HANGS_AFTER}", f"-artifact_prefix={directory}/"]
    arguments = ["--target", target, *options, *limits, str(directory / "corpus")]
    began = time.monotonic()
    with (directory / "log").open("wb") as log:
        code = subprocess.run([sys.executable, __file__, *arguments], stdout=log, stderr=log).returncode
    seconds = time.monotonic() - began
    text = (directory / "log").read_text(errors="replace")
    done, memory = (
        int(number[-1]) if (number := re.findall(rf"stat::{name}: +(\d+)", text)) else 0
        for name in ("number_of_executed_units", "peak_rss_mb")
    )
    verdict = "nothing found" if code == 0 else f"FOUND: {directory / 'log'}"
    print(f"{target:<16} {done:>9} inputs {done / seconds:>7.0f}/s {memory:>4} MB  {verdict}", flush=True)
    return code == 0


def fuzz(target: str, options: list[str]) -> None:
    """Never returns: libFuzzer ends the process."""
    atheris: Any = importlib.import_module("atheris")
    with atheris.instrument_imports(include=INSTRUMENTED, exclude=NOT_INSTRUMENTED):
        module = importlib.import_module(TARGETS[target].module)
        one_input, seeds = module.TARGETS[target]()
    corpus = OUT / target / "corpus"
    corpus.mkdir(parents=True, exist_ok=True)
    for number, seed in enumerate(seeds):
        (corpus / f"seed{number}").write_bytes(seed)
    atheris.Setup([sys.argv[0], *options], within_time(one_input))
    atheris.Fuzz()


def within_time(one_input: Callable[[bytes], None]) -> Callable[[bytes], None]:
    """The same, which raises where an input takes longer than it may."""

    def too_long(*_: object) -> None:
        raise TimeoutError(f"more than {SECONDS_PER_INPUT} s of processor time for one input")

    def timed(data: bytes) -> None:
        signal.setitimer(signal.ITIMER_VIRTUAL, SECONDS_PER_INPUT)
        one_input(data)

    signal.signal(signal.SIGVTALRM, too_long)
    return timed


if __name__ == "__main__":
    sys.exit(main())
