# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip simulate``: drives a scenario on the truth model and prints its final state."""

import argparse
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from trackslip_bags.writer import refuse_existing
from trackslip_common.errors import ExitCode, InputError, show
from trackslip_common.vehicle_files import load_vehicle
from trackslip_sim.devices.nmea_device import RECEIVER_RATE
from trackslip_sim.machine.offline import record_drive
from trackslip_sim.parameters import EmulatorParameters, load_emulator_parameters
from trackslip_sim.scenarios.scenario import load_scenario, scenario_names
from trackslip_sim.scenarios.terrains import terrain_names
from trackslip_sim.truth.record import Truth, TruthWindow
from trackslip_sim.truth.settings import load_settings
from trackslip_sim.truth.simulate import MODES, duration_of, simulate_in_pieces
from trackslip_tools.cli import shared_options
from trackslip_tools.cli.elapsed import waiting_time_s
from trackslip_tools.cli.outputs import require_writable, write_json
from trackslip_tools.cli.progress import progress_bar

EXAMPLE = "trackslip simulate --scenario thesis --soil sandy_loam --json end.json"

_MAX_DURATION = 7 * 86_400.0  # s
_FINAL_COLUMNS = (
    *("x", "y", "z", "yaw", "pitch", "roll", "v_x", "yaw_rate"),
    *("left_slip", "right_slip", "left_thrust", "right_thrust"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``trackslip simulate``."""
    parser.add_argument(
        "--scenario",
        required=True,
        metavar="NAME|FILE",
        help=f"{', '.join(scenario_names())}, or a YAML file",
    )
    shared_options.add_vehicle(parser, "none")
    parser.add_argument("--soil", metavar="S", help="soil outside the scenario's patches; default: its own")
    parser.add_argument(
        "--terrain", metavar="NAME|FILE", help=f"{', '.join(terrain_names())}; default: the scenario's own"
    )
    parser.add_argument(
        "--duration", type=float, metavar="S", help="the scenario repeated or cut to S seconds"
    )
    parser.add_argument("--mode", choices=tuple(MODES), default="shear", help="which truth (default: shear)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the sensors' noise in the bag")
    parser.add_argument("--output", type=Path, metavar="BAG", help="write the sensor data to a bag")
    shared_options.add_json(parser, "the summary")


def run(arguments: argparse.Namespace) -> int:
    """Simulate, print, and write the requested files; returns the exit code."""
    if arguments.duration is not None and not 0.0 < arguments.duration <= _MAX_DURATION:
        raise InputError(
            f"--duration: {arguments.duration:g} s is refused; accepted: > 0 and <= {_MAX_DURATION:g} s"
        )
    scenario = load_scenario(arguments.scenario, arguments.terrain or "", arguments.duration or 0.0)
    vehicle = arguments.vehicle or scenario.vehicle
    receiver = {"gnss.device.rate": RECEIVER_RATE} if load_vehicle(vehicle).has_receiver else {}
    settings = {"scenario": arguments.scenario, "mode": arguments.mode, "seed": arguments.seed}
    p = load_emulator_parameters({**settings, "vehicle": vehicle, **receiver})
    whole, upper = p.vehicle.whole(), p.vehicle.upper_structure
    pieces = simulate_in_pieces(
        scenario, soil=arguments.soil, mode=arguments.mode, vehicle=whole, upper=upper
    )
    duration = duration_of(scenario, load_settings())
    refuse_existing(arguments.output)
    require_writable(json=arguments.json)
    window = (
        _record_to_end(p, pieces, duration, arguments.output)
        if arguments.output
        else _simulate_to_end(pieces, duration)
    )
    elapsed = waiting_time_s()
    show(summary_text(p.vehicle.name, window.truth, elapsed))
    if arguments.output is not None:
        show(f"bag: {arguments.output}")
    if arguments.json is not None:
        write_json(arguments.json, {"vehicle": p.vehicle.name, **summary(window.truth, elapsed)})
    return int(ExitCode.DONE)


def _simulate_to_end(pieces: Iterable[Truth], duration: float) -> TruthWindow:
    """Simulate to the end, with a progress bar; returns the last window."""
    with progress_bar(duration, "simulating") as advance:
        window = TruthWindow(_report_progress(pieces, advance), duration)
        window.advance(duration)
    return window


def _record_to_end(
    p: EmulatorParameters, pieces: Iterable[Truth], duration: float, path: Path
) -> TruthWindow:
    """Simulate and record to the end into a new bag, with a progress bar; returns the last window."""
    with progress_bar(p.lead_in + duration, "simulating") as advance:
        window = TruthWindow(pieces, duration)
        record_drive(p, window, path, advance)
    window.advance(duration)
    return window


def _report_progress(pieces: Iterable[Truth], advance: Callable[[float], None]) -> Iterator[Truth]:
    reached = 0.0
    for piece in pieces:
        yield piece
        advance(float(piece.t[-1]) - reached)
        reached = float(piece.t[-1])


def summary_text(vehicle: str, truth: Truth, elapsed: float) -> str:
    """Text of the summary for the terminal."""
    end = _final_values(truth)
    speed = truth.duration / elapsed
    return "\n".join(
        (
            f"vehicle: {vehicle}",
            f"{truth.duration:.1f} s simulated in {elapsed:.1f} s ({speed:.0f} × real time)",
            f"final  x {end['x']:.3f} m  y {end['y']:.3f} m  yaw {end['yaw']:.4f} rad",
            f"  speed {end['v_x']:.3f} m/s  yaw rate {end['yaw_rate']:.4f} rad/s",
            *(
                f"  {side:<5} track: slip {100.0 * end[f'{side}_slip']:.1f} %, "
                f"thrust {round(end[f'{side}_thrust'])} N"
                for side in ("left", "right")
            ),
        )
    )


def summary(truth: Truth, elapsed: float) -> dict[str, object]:
    """Content of the JSON file: last sample, duration, s, and elapsed time, s."""
    return {"final": _final_values(truth), "duration_s": truth.duration, "elapsed_s": elapsed}


def _final_values(truth: Truth) -> dict[str, float]:
    return {name: float(getattr(truth, name)[-1]) for name in _FINAL_COLUMNS}
