# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The soil estimator in ``trackslip replay``: its result and messages, and their repeatability."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fixtures.commands import json_of
from fixtures.made_bags import write_messages
from fixtures.recorded import merged_messages
from fixtures.swinging_cab import Cab, dig, record

from trackslip_bags.messages import make
from trackslip_bags.reader import open_bag
from trackslip_common.soils import soil
from trackslip_estimation.slip import conversions as slip
from trackslip_estimation.slip.estimator import SlipEstimator, make_estimate
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.slip.records import to_records
from trackslip_estimation.soil.conversions import machine_state
from trackslip_estimation.soil.pressure_watch import PressureFault
from trackslip_estimation.soil.records import SOIL_INPUT, inputs_from_estimates

Summary = Callable[..., dict[str, Any]]
KEYS = {"mu_r", "mu_l", "K", "K_interval", "F_max", "F_max_interval", "identifiable", "classes"}


@pytest.fixture(scope="module")
def replayed(emulated_bag: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """The bag of the estimates, and the summary."""
    folder = tmp_path_factory.mktemp("soil")
    return folder / "out", json_of(folder, "replay", emulated_bag, "--output", folder / "out")


def test_summary_has_the_soil(replayed: tuple[Path, dict[str, Any]]) -> None:
    result, true = replayed[1]["soil"], soil("sandy_loam")
    assert result.keys() >= KEYS
    assert result["mu_r"] == pytest.approx(true.value("mu_r"), rel=0.05)
    for name in ("K", "F_max"):
        low, high = result[f"{name}_interval"]
        assert low < result[name] < high
    assert sum(result["classes"].values()) == pytest.approx(1.0)
    assert "none of these" in result["classes"]


def test_forces_and_soil_are_in_the_output(replayed: tuple[Path, dict[str, Any]]) -> None:
    with open_bag(replayed[0]) as bag:
        counts = {topic: info.count for topic, info in bag.topics.items()}
    assert counts["/soil_estimator/parameters"] == 1
    assert 40 <= counts["/soil"] <= 60
    assert 400 <= counts["/track_forces"] <= 600


@pytest.mark.slow
def test_replay_reproduces_live_forces(
    emulated_bag: Path, replayed: tuple[Path, dict[str, Any]], tmp_path: Path, summary: Summary
) -> None:
    """Sensors and estimates in one bag; without the journal, whose log times differ from a recorder's."""
    live = write_messages(tmp_path / "live", merged_messages(emulated_bag, replayed[0]))
    result = summary(live)
    assert result["soil"]["replay_matches"] is True
    assert result["soil"]["mu_r"] == replayed[1]["soil"]["mu_r"]
    other = summary(live, "--set", "soil_estimator.dynamics.mu_r_walk=0.05")
    assert other["soil"]["replay_matches"] is False


@pytest.mark.parametrize("vehicle", ["pc05_cab", "pc05"])
def test_replay_feeds_the_soil_estimator_its_live_inputs(vehicle: str) -> None:
    """Bit for bit, including swing and tilt where they are known."""
    estimator = SlipEstimator(load_slip_parameters({"vehicle": vehicle}))
    measurements = record(dig()[:6], Cab(encoder=vehicle == "pc05_cab")).measurements
    results = estimator.process_records(to_records(measurements, estimator.sources))
    rows = results["estimate"][results["published"] == 1]
    live = np.zeros(len(rows), SOIL_INPUT)
    for to, row in zip(live, rows, strict=True):
        message = slip.machine_state(make, make_estimate(row.item()), "map", "base_link")
        machine_state(message).write_to(to)
    np.testing.assert_array_equal(inputs_from_estimates(rows), live)
    assert len(rows) > 200
    assert np.isfinite(live["swing_variance"]).all() == (vehicle == "pc05_cab")


def test_withheld_hydraulics_are_reported_and_a_bag_without_them_has_no_soil(
    emulated_bag: Path, bag: Path, summary: Summary
) -> None:
    blind = summary(emulated_bag, "--withhold", "hydraulics:20:40", "--stop", "45")["soil"]
    assert blind["rejected"]["hydraulics"][PressureFault.DROPPED.value] > 1500
    assert "soil" not in summary(bag)


def test_unknown_parameter_is_refused(emulated_bag: Path, refuse: Callable[..., str]) -> None:
    assert "'nonsense'" in refuse("replay", emulated_bag, "--set", "soil_estimator.nonsense=1")
