# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A node writes its state file once a minute of the steady clock while active, and at its end."""

from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
from fixtures.drawn_machine import Machine, drive, parameters
from fixtures.patience import wait_for
from rclpy.clock import ClockType

from trackslip_estimation.nodes.state_keeper import StateKeeper
from trackslip_estimation.slip.estimator import SlipEstimator


class Node:
    """The part of a node that the keeper uses."""

    def __init__(self, state_file: Path) -> None:
        self.settings = parameters(state_file=str(state_file))
        self.active = True
        self.timers: list[tuple[float, Callable[[], None], Any]] = []
        self.log = Mock()

    def get_logger(self) -> Any:
        return self.log

    def create_timer(self, period: float, callback: Callable[[], None], clock: Any) -> None:
        self.timers.append((period, callback, clock))


@pytest.fixture
def driven(tmp_path: Path) -> tuple[Any, StateKeeper, Path]:
    """A node whose estimator has driven for ten seconds, its keeper, and the state file."""
    node: Any = Node(tmp_path / "state.yaml")
    estimator = SlipEstimator(node.settings)
    keeper = StateKeeper(node, lambda: estimator)
    estimator.process_all(drive(Machine(duration=10.0)).measurements)
    return node, keeper, tmp_path / "state.yaml"


def test_state_file_is_written_once_a_minute(driven: tuple[Any, StateKeeper, Path]) -> None:
    node, _, file = driven
    ((period, save, clock),) = node.timers
    assert (period, clock.clock_type) == (60.0, ClockType.STEADY_TIME)
    assert not file.exists()
    save()  # starts a thread
    wait_for(file.exists)
    assert "checksum" in file.read_text(encoding="utf-8")


def test_state_file_is_not_written_while_the_node_is_inactive(driven: tuple[Any, StateKeeper, Path]) -> None:
    node, keeper, file = driven
    node.active = False
    node.timers[0][1]()
    assert not file.exists()
    keeper.finish()
    assert file.exists()


def test_without_a_file_there_is_no_timer() -> None:
    node: Any = Node(Path())
    node.settings = parameters(state_file="")
    StateKeeper(node, lambda: SlipEstimator(node.settings)).finish()
    assert node.timers == []
