# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Makes the recorded runs of bags/ and their manifest (``make bags``).

The named bags, or all, are recorded again by the current drivers and emulator, and the manifest is written.
``--numbers`` writes only the expected results of replays of the existing bags, after a change of the
estimator or its parameters.
"""

import argparse
import hashlib
import os
import shutil
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import yaml

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.messages import make, serialize
from trackslip_bags.parameters import PARAMETERS_TOPIC, PARAMETERS_TYPE, bag_parameters, bag_vehicle
from trackslip_bags.reader import absolute_name, open_bag
from trackslip_bags.writer import BagWriter
from trackslip_common.config_files import node_defaults, parameters_text
from trackslip_common.vehicle_files import vehicle_layer
from trackslip_estimation.slip.parameters import NODE, load_slip_parameters
from trackslip_sim.devices.nmea_device import RECEIVER_RATE
from trackslip_sim.machine.excavator import simulate_drive
from trackslip_sim.machine.offline import record_drive
from trackslip_sim.parameters import load_emulator_parameters
from trackslip_tools.replay.output import summary
from trackslip_tools.replay.run import replay

BAGS = Path(__file__).resolve().parents[1] / "bags"
MANIFEST = BAGS / "manifest.yaml"
_ROS = "kilted"  # distribution in metadata.yaml, on every machine
_HEAD = """\
# The recorded runs of this folder, written by scripts/make_bags.py (make bags). Each is a drive of the
# emulated excavator: what its drivers publish, and the truth. 'made' is how, 'holds' what is in it, 'replay'
# what trackslip replay gives with the parameters of config/, to within 'tolerances' (m, rad, 1).
"""
_TOLERANCES = {"position": 0.002, "heading": 0.002, "slip": 0.005, "nees": 0.2}


@dataclass(frozen=True)
class Recipe:
    """Parameters of a recorded run."""

    scenario: str  # of config/scenarios, or a file in bags/
    seed: int
    soil: str = ""  # empty: the scenario's own
    duration: float = 0.0  # s; 0: the scenario's own
    kept: float = 1.0  # share of the file's bytes left after a power cut
    vehicle: str = ""  # empty: the scenario's own
    imu_rate: float = 0.0  # Hz; 0: the vehicle's own
    parameters: str = ""  # file of config/ with the slip estimator's parameters in the bag
    topics: tuple[str, ...] = ()  # topics kept; empty: all
    truth_every: int = 1  # one of this many messages of the truth is kept


RECIPES = {
    "slalom_sand": Recipe("slalom", seed=1, soil="sand", duration=24.0),
    "spot_turn_sand": Recipe("spot_turn", seed=2, soil="sand"),
    "outage_sandy_loam": Recipe("scenarios/outage.yaml", seed=3),
    "soft_patch": Recipe("scenarios/soft_patch.yaml", seed=4),
    "slope_up_sand": Recipe("scenarios/slope_up.yaml", seed=6),
    "slope_across_sandy_loam": Recipe("scenarios/slope_across.yaml", seed=7),
    "example": Recipe(  # small bag of the Python package, of a machine with a GNSS receiver
        "slalom",
        seed=8,
        duration=10.0,
        vehicle="excavator_20t",
        imu_rate=50.0,
        parameters="gnss.yaml",
        topics=(
            *("vehicle", "sprockets", "imu/data_raw", "hydraulics", "fix", "gnss_pose", "heading"),
            *("truth/odometry", "truth/track_slip"),
        ),
        truth_every=10,
    ),
    "power_cut": Recipe("start_stop", seed=5, soil="dry_clay", duration=24.0, kept=0.7),
}


def record(name: str, folder: Path) -> None:
    """Record the recipe ``name`` into a new bag in ``folder``."""
    recipe, path = RECIPES[name], folder / name
    local = BAGS / recipe.scenario
    parameters: dict[str, Any] = {"scenario": str(local) if local.is_file() else recipe.scenario}
    parameters |= {"soil": recipe.soil, "seed": recipe.seed, "duration": recipe.duration}
    if recipe.vehicle:
        parameters |= {"vehicle": recipe.vehicle, "gnss.device.rate": RECEIVER_RATE}
    if recipe.imu_rate:
        parameters["vehicle.sensors.imu.rate"] = recipe.imu_rate
    p = load_emulator_parameters(parameters)
    if recipe.topics:
        with tempfile.TemporaryDirectory() as whole_folder:
            record_drive(p, simulate_drive(p), Path(whole_folder) / name)
            _shorten(Path(whole_folder) / name, path, recipe)
    else:
        record_drive(p, simulate_drive(p), path)
    if recipe.kept < 1.0:
        (file,) = path.glob("*.mcap")
        content = file.read_bytes()
        file.write_bytes(content[: int(recipe.kept * len(content))])
        (path / "metadata.yaml").unlink()


def _shorten(whole: Path, path: Path, recipe: Recipe) -> None:
    """Copy the topics of the recipe to a new bag that begins with the parameters."""
    counts: Counter[str] = Counter()
    text = parameters_text(node_defaults(NODE, recipe.parameters), NODE)
    with open_bag(whole) as bag, BagWriter(path) as shorter:
        data = serialize(make(PARAMETERS_TYPE, data=text))
        shorter.write(absolute_name(PARAMETERS_TOPIC), PARAMETERS_TYPE, data, bag.start_ns)
        for message in bag.messages(recipe.topics):
            counts[message.topic] += 1
            if not message.topic.startswith("/truth/") or counts[message.topic] % recipe.truth_every == 1:
                shorter.write(message.topic, message.type_name, message.raw, message.log_time_ns)


def digests(path: Path) -> dict[str, str]:
    """File name → SHA-256 of the files of a bag."""
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in sorted(path.iterdir())}


def contents(path: Path) -> dict[str, Any]:
    """Duration, damage and message counts, as in ``trackslip info``."""
    with open_bag(path) as bag:
        counts = {topic: info.count for topic, info in sorted(bag.topics.items())}
        return {"duration_s": round(bag.duration_s, 6), "damaged": bool(bag.damage), "messages": counts}


def expected(path: Path) -> dict[str, Any]:
    """Results of a replay, named as in its JSON."""
    with open_bag(path) as bag:
        vehicle = bag_vehicle(bag)
        p = load_slip_parameters({} if vehicle is None else vehicle_layer(vehicle), bag_parameters(bag))
        result = replay(bag, p, InputFilters(), None)
        results = summary(result, result.elapsed_s)
    rmse = {name: round(value, 5) for name, value in results["rmse"].items() if value is not None}
    final = {name: round(value, 5) for name, value in results["final"].items()}
    return {"final": final, "rmse": rmse, "nees": round(results["nees"], 3), "rejected": results["rejected"]}


def entry(name: str) -> dict[str, Any]:
    """The manifest's entry of an existing bag, without the results of replays."""
    recipe = RECIPES[name]
    values = ((field, getattr(recipe, field.name)) for field in fields(recipe))
    changes = {field.name: value for field, value in values if value != field.default}
    return {"made": changes, "sha256": digests(BAGS / name), "holds": contents(BAGS / name)}


def main() -> int:
    """Record bags, or refresh the expected results; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="of the bags; all where none is named")
    parser.add_argument(
        "--numbers", action="store_true", help="only refresh what replays are expected to give"
    )
    args = parser.parse_args()
    os.environ["ROS_DISTRO"] = _ROS
    manifest = yaml.safe_load(MANIFEST.read_text(encoding="utf-8"))["bags"]
    names = args.names or list(RECIPES)
    for name in () if args.numbers else names:
        shutil.rmtree(BAGS / name, ignore_errors=True)
        record(name, BAGS)
        manifest[name] = entry(name)
    for name in names:
        described_bag = manifest[name]
        described_bag["replay"] = expected(BAGS / name)
        print(f"{name}: {described_bag['replay']['rmse']}")
    text = yaml.safe_dump({"tolerances": _TOLERANCES, "bags": manifest}, sort_keys=False, width=110)
    MANIFEST.write_text(_HEAD + text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
