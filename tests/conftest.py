# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What tests share: repeatable hypothesis, the folder of real data, and a small kinematic truth."""

import gc
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from trackslip_common.arrays import FloatArray
from trackslip_estimation.slip.measurements import Measurement, PoseFix, Sprockets, YawRate

if TYPE_CHECKING:
    from _pytest.terminal import TerminalReporter  # pytest's own names it from 9 on

pytest_plugins = [
    "fixtures.browser",
    "fixtures.full_disk",
    "fixtures.real_time",
    "fixtures.recorded",
    "fixtures.tf2_messages",
    "fixtures.thesis",
]

Segment = tuple[float, float, float, float, float, float]  # s; ω_L, ω_R rad/s; i_L, i_R; α rad

ROOT = Path(__file__).parents[1]
RADIUS, TREAD = 0.159, 0.73  # m, those of config/vehicles/pc05.yaml
MS = 1_000_000

gc.set_threshold(50_000)  # with Python's own a worker looks for garbage for a twelfth of its time

settings.register_profile("trackslip", derandomize=True, deadline=None, max_examples=30)
settings.register_profile(  # make fuzz
    "fuzz",
    max_examples=int(os.environ.get("RUNS") or 10_000),
    deadline=timedelta(seconds=10),
    suppress_health_check=list(HealthCheck),
    print_blob=True,
)
settings.load_profile("trackslip")


@pytest.hookimpl(tryfirst=True)  # before xdist looks at the groups
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """A module's tests share fixtures and caches, so one worker runs them.

    ``graph``, which takes longest, begins; ``tools`` and ``sim``, whose modules are long, come before others.
    """
    if not hasattr(config, "workerinput"):
        return
    for item in items:
        if item.get_closest_marker("xdist_group") is None:
            item.add_marker(pytest.mark.xdist_group(item.path.relative_to(ROOT).as_posix()))

    def order(item: pytest.Item) -> tuple[bool, str]:
        return ("graph",) in [mark.args for mark in item.iter_markers("xdist_group")], str(item.path)

    items.sort(key=order, reverse=True)


def pytest_collection_finish() -> None:
    """Thousands of tests were collected, and are no garbage."""
    gc.freeze()


def pytest_terminal_summary(terminalreporter: "TerminalReporter") -> None:
    """Why a test was run again, which passing then would hide."""
    for report in terminalreporter.getreports("rerun"):
        terminalreporter.section(f"first run of {report.nodeid}")
        terminalreporter.line(report.longreprtext)


@pytest.fixture(scope="module", autouse=True)
def environment_of_others() -> Iterator[None]:
    """Commands that run in this process set variables of ROS, which the nodes of later modules would take."""
    before = dict(os.environ)
    yield
    for name in {*os.environ} - {*before}:
        del os.environ[name]
    os.environ.update(before)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real logs; a test that asks for it is skipped where it is absent."""
    folder = Path(os.environ.get("TRACKSLIP_SHARED", ROOT.parent / "shared")) / "data"
    if not folder.is_dir():
        pytest.skip(f"no real data in {folder}")
    return folder


@dataclass
class Drive:
    """Measurements in the order of their stamps, and the truth behind them."""

    measurements: list[Measurement] = field(default_factory=list)
    truth: dict[int, FloatArray] = field(default_factory=dict)  # stamp → x y φ i_L i_R α b_g


@pytest.fixture(scope="session")
def drive() -> Callable[..., Drive]:
    """A function that drives (3.17)–(3.20) exactly: constant twist over each sprocket sample."""
    return _drive


def _drive(
    segments: Sequence[Segment],
    *,
    seed: int = 0,
    step_ms: int = 20,
    gyro_every: int = 5,
    fix_every: int = 10,
    slip_walk: float = 0.0,  # 1/√s, on top of the slips of the segments
    encoder: float = 0.0,  # √s
    gyro_bias: float = 0.0,
    gyro_sigma: float = 0.005,
    fix_sigma: tuple[float, float, float] = (0.03, 0.03, 0.02),
    positions: bool = True,
) -> Drive:
    rng = np.random.default_rng(seed)
    dt = step_ms * 1e-3
    rows = [row for row in segments for _ in range(round(row[0] / dt))]
    drive, pose = Drive(), np.zeros(3)
    wander, turned, rate = np.zeros(2), np.zeros(2), 0.0
    covariance = np.diag(np.square(fix_sigma))
    for k, (_, left, right, *slips) in enumerate([rows[0], *rows]):
        stamp_ns, speeds = k * step_ms * MS, np.array((left, right))
        i = np.array(slips[:2]) + wander
        if k > 0:
            v_left, v_right = RADIUS * speeds * (1.0 - i)
            v_x, rate = (v_left + v_right) / 2.0, (v_right - v_left) / TREAD
            c, s = np.cos(pose[2] + rate * dt / 2.0), np.sin(pose[2] + rate * dt / 2.0)
            chord = v_x * dt * np.sinc(rate * dt / 2.0 / np.pi)
            tan = np.tan(slips[2])
            pose = pose + np.array((chord * (c - s * tan), chord * (s + c * tan), rate * dt))
            wander = wander + rng.normal(0.0, slip_walk, 2) * np.sqrt(dt)
            speeds = speeds * (1.0 + encoder * rng.normal(size=2) / np.sqrt(dt))
            turned = turned + speeds * dt
        drive.truth[stamp_ns] = np.concatenate((pose, i, (slips[2], gyro_bias)))
        angles = (float(turned[0]), float(turned[1])) if positions else None
        left_speed, right_speed = speeds.tolist()
        drive.measurements.append(Sprockets("sprockets", stamp_ns, left_speed, right_speed, angles))
        if k % gyro_every == 0 and k > 0:
            reading = float(rate + gyro_bias + rng.normal(0.0, gyro_sigma))
            drive.measurements.append(YawRate("imu/data_raw", stamp_ns, reading, gyro_sigma**2))
        if k % fix_every == 0:
            fix = pose + rng.normal(0.0, fix_sigma)
            drive.measurements.append(PoseFix("box_pose", stamp_ns, fix, covariance))
    return drive
