# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Animates the demo's drive: the machine on the map, and its estimated slips."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib import colormaps
from matplotlib import pyplot as plt
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.axes import Axes
from matplotlib.patches import Polygon

from trackslip_common.vehicle import Kinematics
from trackslip_tools.replay.series import Path as Reckoned
from trackslip_tools.replay.series import Series

FRAMES, FRAMES_PER_SECOND = 80, 10
WIDTH = 0.23  # m, width of a drawn track
MOST = 0.15  # slip of the darkest colour
ESTIMATE, TRUTH, ENCODERS = "#0072b2", "#222222", "#d55e00"
RANGE = (-0.05, 0.2)  # of the slip axis


class Run(NamedTuple):
    """An estimated drive and its truth."""

    estimates: Series  # pose, slips, slip_covariance
    truth: Series  # x, y
    true_slips: Series
    encoders: Reckoned  # odometry of the encoders alone


def animate(run: Run, kinematics: Kinematics, file: Path) -> None:
    """Write the drive as GIF: the path, the machine with tracks coloured by slip, and the slips."""
    start, end = int(run.estimates.stamps_ns[0]), int(run.estimates.stamps_ns[-1])
    moments = np.linspace(start, end, FRAMES).astype(np.int64)
    figure = plt.figure(figsize=(8.4, 3.6), layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=(1.25, 1.0))
    path = _Map(figure.add_subplot(grid[:, 0]), run, kinematics)
    slips = [_Slip(figure.add_subplot(grid[row, 1]), run, row) for row in (0, 1)]
    slips[1].axes.set_xlabel("time, s")

    def draw(frame: int) -> None:
        path.draw(int(moments[frame]))
        for each in slips:
            each.draw(int(moments[frame]))

    animation = FuncAnimation(figure, draw, frames=FRAMES)
    animation.save(file, writer=PillowWriter(fps=FRAMES_PER_SECOND), dpi=80)
    plt.close(figure)


class _Map:
    """Map with the paths up to a time, and the machine."""

    def __init__(self, axes: Axes, run: Run, kinematics: Kinematics) -> None:
        self.run, self.kinematics = run, kinematics
        self.truth = run.truth.columns("x", "y")
        both = np.concatenate((self.truth, run.encoders.poses[:, :2]))
        axes.plot(*self.truth.T, color="0.85", lw=1.0)
        (self.encoder_line,) = axes.plot([], [], color=ENCODERS, lw=1.2, ls="--", label="encoders alone")
        (self.truth_line,) = axes.plot([], [], color=TRUTH, lw=2.5, label="truth")
        (self.estimate_line,) = axes.plot([], [], color=ESTIMATE, lw=1.2, label="estimate")
        self.tracks = [axes.add_patch(Polygon(np.zeros((4, 2)), ec=TRUTH, lw=0.8)) for _ in (0, 1)]
        low, high = both.min(axis=0) - 0.8, both.max(axis=0) + 0.8
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x, m", ylabel="y, m", aspect="equal")
        axes.grid(alpha=0.3)
        axes.legend(loc="lower left", fontsize="small")

    def draw(self, now: int) -> None:
        estimates = self.run.estimates
        for line, stamps, points in (
            (self.encoder_line, self.run.encoders.stamps_ns, self.run.encoders.poses),
            (self.truth_line, self.run.truth.stamps_ns, self.truth),
            (self.estimate_line, estimates.stamps_ns, estimates["pose"]),
        ):
            line.set_data(*points[: int(np.searchsorted(stamps, now, "right")), :2].T)
        row = min(int(np.searchsorted(estimates.stamps_ns, now)), len(estimates) - 1)
        x, y, yaw = estimates["pose"][row]
        half = self.kinematics.contact_length / 2.0
        for side, (track, sign) in enumerate(zip(self.tracks, (1.0, -1.0), strict=True)):
            middle = sign * self.kinematics.tread / 2.0
            corners = np.array(
                [(a * half, middle + b * WIDTH / 2) for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1))]
            )
            turned = corners @ np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
            track.set_xy(turned + np.array((x, y)))
            track.set_facecolor(colormaps["YlOrRd"](min(1.0, abs(estimates["slips"][row, side]) / MOST)))


class _Slip:
    """Slip of one track up to a time, with a band of two standard deviations."""

    def __init__(self, axes: Axes, run: Run, side: int) -> None:
        self.axes, self.start = axes, int(run.truth.stamps_ns[0])
        name = ("left_slip", "right_slip")[side]
        self.t = (run.estimates.stamps_ns - self.start) * 1e-9
        self.slip = run.estimates["slips"][:, side]
        self.sigma = np.sqrt(run.estimates["slip_covariance"][:, side, side])
        self.true_t = (run.true_slips.stamps_ns - self.start) * 1e-9
        self.true_slip = np.asarray(run.true_slips[name])
        (self.truth_line,) = axes.plot([], [], color=TRUTH, lw=1.5, label="truth")
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
        self.truth_line.set_data(self.true_t[:m], self.true_slip[:m])
        self.band.remove()
        low, high = self.slip[:n] - 2.0 * self.sigma[:n], self.slip[:n] + 2.0 * self.sigma[:n]
        self.band = self.axes.fill_between(self.t[:n], low, high, color=ESTIMATE, alpha=0.2, lw=0.0)
