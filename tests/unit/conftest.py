# SPDX-License-Identifier: Apache-2.0
"""The estimator with the thesis' own model and fixed noise, whatever the defaults are; a pty; refusals."""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from trackslip_common.errors import ExitCode
from trackslip_estimation.cli.main import main
from trackslip_estimation.measurements import Measurement, Report
from trackslip_estimation.slip_estimator import Estimate, SlipEstimator
from trackslip_estimation.slip_parameters import SlipEstimatorParameters, load_slip_parameters
from trackslip_sim.devices.pty_port import PtyPort

_NOISE = {
    "model": "free_slips",
    "noise.encoder": 0.002,
    "noise.slip_steady": 0.01,
    "noise.slip_moving": 0.02,
    "noise.slip_angle_steady": 0.0,
    "noise.slip_angle_turning": 0.0,
    "noise.gyro_bias": 1e-5,
    "noise.initial_slip": 0.1,
    "noise.initial_slip_angle": 0.01,
    "noise.initial_gyro_bias": 0.01,
}
_START = {"start": "initial_pose", "initial_position_stddev": 0.03, "pose_timeouts": [1.0]}


class Outcomes(NamedTuple):
    """What the estimator said to a row of measurements."""

    reports: list[Report]
    estimates: list[Estimate]


@pytest.fixture(scope="session")
def thesis_parameters() -> Callable[..., SlipEstimatorParameters]:
    """A function of changes to the parameters; `__` stands for the dot."""
    return _parameters


@pytest.fixture(scope="session")
def thesis_run() -> Callable[..., Outcomes]:
    """A function of measurements and changes that runs the one through an estimator with the others."""

    def run(measurements: Iterable[Measurement], **changes: Any) -> Outcomes:
        estimator = SlipEstimator(_parameters(**changes))
        steps = [estimator.advance(m) for m in measurements]
        return Outcomes([r for r, _ in steps], [e for _, e in steps if e is not None])

    return run


def _parameters(**changes: Any) -> SlipEstimatorParameters:
    return load_slip_parameters(_NOISE | _START, {k.replace("__", "."): v for k, v in changes.items()})


@pytest.fixture
def pty_port(tmp_path: Path) -> Iterator[PtyPort]:
    """A pseudo terminal, whose other end a ``SerialPort`` can open."""
    port = PtyPort(tmp_path / "device")
    yield port
    if port.link.is_symlink():
        port.close()


@pytest.fixture
def refusal(capsys: pytest.CaptureFixture[str]) -> Callable[[list[str]], str]:
    """What ``trackslip`` says of arguments that it refuses: a line, and nothing else."""

    def said_of(arguments: list[str]) -> str:
        assert main(arguments) == ExitCode.BAD_INPUT
        shown, said = capsys.readouterr()
        assert shown == ""
        assert said.count("\n") == 1
        return said

    return said_of
