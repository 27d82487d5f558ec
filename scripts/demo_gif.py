# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The demo's drive as a moving picture: the machine on the map, its slips as they are estimated."""

from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib import pyplot as plt
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.axes import Axes
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from trackslip_common.vehicle import Kinematics
from trackslip_sim.demo.results import DemoResult

FloatArray = NDArray[np.float64]

FRAMES, FRAMES_PER_SECOND = 80, 10
WIDTH = 0.23  # m, of a drawn track
MOST = 0.15  # slip of the darkest colour
ESTIMATE, TRUTH, ENCODERS = "#0072b2", "#222222", "#d55e00"
RANGE = (-0.05, 0.2)  # of the axis of slips


def animate(result: DemoResult, kinematics: Kinematics, file: Path) -> None:
    """Write the drive as GIF: the path with each track coloured by its slip, and the slips."""
    start, end = int(result.odometry.stamps_ns[0]), int(result.odometry.stamps_ns[-1])
    moments = np.linspace(start, end, FRAMES).astype(np.int64)
    figure = plt.figure(figsize=(8.4, 3.6), layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=(1.25, 1.0))
    path = _Map(figure.add_subplot(grid[:, 0]), result, kinematics)
    slips = [_Slip(figure.add_subplot(grid[row, 1]), result, row) for row in (0, 1)]
    slips[1].axes.set_xlabel("time, s")

    def draw(frame: int) -> None:
        path.draw(int(moments[frame]))
        for each in slips:
            each.draw(int(moments[frame]))

    moving = FuncAnimation(figure, draw, frames=FRAMES)
    moving.save(file, writer=PillowWriter(fps=FRAMES_PER_SECOND), dpi=80)
    plt.close(figure)


class _Map:
    """Paths up to a moment, and the machine."""

    def __init__(self, axes: Axes, result: DemoResult, kinematics: Kinematics) -> None:
        self.result, self.kinematics = result, kinematics
        self.truth, self.encoders = result.truth, result.paths["dead_reckoning"]
        both = np.concatenate((self.truth.poses[:, :2], self.encoders.poses[:, :2]))
        axes.plot(*self.truth.poses[:, :2].T, color="0.85", lw=1.0)
        (self.ran,) = axes.plot([], [], color=ENCODERS, lw=1.2, ls="--", label="encoders alone")
        (self.true,) = axes.plot([], [], color=TRUTH, lw=2.5, label="truth")
        (self.found,) = axes.plot([], [], color=ESTIMATE, lw=1.2, label="estimate")
        self.tracks = [axes.add_patch(Polygon(np.zeros((4, 2)), ec=TRUTH, lw=0.8)) for _ in (0, 1)]
        low, high = both.min(axis=0) - 0.8, both.max(axis=0) + 0.8
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x, m", ylabel="y, m", aspect="equal")
        axes.grid(alpha=0.3)
        axes.legend(loc="lower left", fontsize="small")

    def draw(self, now: int) -> None:
        odometry = self.result.odometry
        for line, stamps, points in (
            (self.ran, self.encoders.stamps_ns, self.encoders.poses),
            (self.true, self.truth.stamps_ns, self.truth.poses),
            (self.found, odometry.stamps_ns, odometry.columns("x", "y")),
        ):
            line.set_data(*points[: int(np.searchsorted(stamps, now, "right")), :2].T)
        x, y, yaw = self.result.paths["filter"].at(np.array([now]))[0]
        half = self.kinematics.contact_length / 2.0
        for side, (track, sign) in enumerate(zip(self.tracks, (1.0, -1.0), strict=True)):
            middle = sign * self.kinematics.tread / 2.0
            corners = np.array(
                [(a * half, middle + b * WIDTH / 2) for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1))]
            )
            turned = corners @ np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
            track.set_xy(turned + np.array((x, y)))
            track.set_facecolor(colormaps["YlOrRd"](min(1.0, abs(_slip_at(self.result, side, now)) / MOST)))


class _Slip:
    """Slip of one track up to a moment, with two standard deviations."""

    def __init__(self, axes: Axes, result: DemoResult, side: int) -> None:
        self.axes, self.start = axes, int(result.truth.stamps_ns[0])
        name = ("left_slip", "right_slip")[side]
        self.t = (result.slips.stamps_ns - self.start) * 1e-9
        self.slip = np.asarray(result.slips[name])
        self.sigma = np.sqrt(result.slips["covariance"][:, side, side])
        self.true_t = (result.true_slips.stamps_ns - self.start) * 1e-9
        self.true = np.asarray(result.true_slips[name])
        (self.truth,) = axes.plot([], [], color=TRUTH, lw=1.5, label="truth")
        (self.line,) = axes.plot([], [], color=ESTIMATE, lw=1.2, label="estimate, ±2σ")
        self.band = axes.fill_between([0.0], [0.0], [0.0], color=ESTIMATE, alpha=0.2, lw=0.0)
        axes.set(xlim=(0.0, self.t[-1]), ylim=RANGE, ylabel=name.replace("_", " "))
        axes.grid(alpha=0.3)
        if side == 0:
            axes.legend(loc="upper right", fontsize="small", ncols=2)

    def draw(self, now: int) -> None:
        seconds = (now - self.start) * 1e-9
        n, m = int(np.searchsorted(self.t, seconds)), int(np.searchsorted(self.true_t, seconds))
        self.line.set_data(self.t[:n], self.slip[:n])
        self.truth.set_data(self.true_t[:m], self.true[:m])
        self.band.remove()
        low, high = self.slip[:n] - 2.0 * self.sigma[:n], self.slip[:n] + 2.0 * self.sigma[:n]
        self.band = self.axes.fill_between(self.t[:n], low, high, color=ESTIMATE, alpha=0.2, lw=0.0)


def _slip_at(result: DemoResult, side: int, now: int) -> float:
    n = int(np.searchsorted(result.slips.stamps_ns, now))
    return float(result.slips[("left_slip", "right_slip")[side]][min(n, len(result.slips) - 1)])
