# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Draws the figures of the thesis and the animation of the demo into docs/figures (``make figures``)."""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from demo_gif import Run, animate
from trackslip_bags.input_filters import InputFilters
from trackslip_bags.parameters import bag_parameters
from trackslip_bags.reader import open_bag
from trackslip_common.arrays import FloatArray
from trackslip_common.soils import Soil, load_soils
from trackslip_common.topics import TRUE_ODOMETRY, TRUE_SLIP
from trackslip_common.vehicle import Vehicle
from trackslip_common.vehicle_files import load_vehicle
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.slip.records import ESTIMATE
from trackslip_estimation.terramechanics.resistance import longitudinal_resistance
from trackslip_estimation.terramechanics.strength import thrust_limit
from trackslip_estimation.terramechanics.traction import slip_of_thrust, slip_of_thrust_approximate, thrust
from trackslip_estimation.terramechanics.turning import (
    centre_point,
    centre_point_approximate,
    moment_with_centrifugal_force,
    triangular_moment,
)
from trackslip_sim.machine.excavator import simulate_drive
from trackslip_sim.machine.offline import START_NS, record_drive
from trackslip_sim.parameters import load_emulator_parameters
from trackslip_sim.scenarios.scenario import load_scenario
from trackslip_sim.study.plots import BAND, COLOURS, DASHES, GREY, STYLE, label_axes, make_panels, save_figure
from trackslip_sim.study.slip.figures import run_figures
from trackslip_sim.study.slip.parameters import load_study_parameters
from trackslip_sim.truth.record import Truth
from trackslip_sim.truth.simulate import simulate
from trackslip_tools.replay.growing import GrowingRows
from trackslip_tools.replay.run import replay
from trackslip_tools.replay.series import Series, sort_by_stamp

OUTPUT = Path(__file__).resolve().parents[1] / "docs" / "figures"
TABLE_6_1 = ("sand", "sandy_loam", "clayey_soil", "dry_clay")
FAST_TURN = 1.37  # rad/s, one track braked
NORMAL_MU_L = (0.5, 1.3)
MU_L = np.linspace(0.1, 1.5, 281)
DEMO_SCENARIO, DEMO_SOIL, DEMO_DURATION = "thesis", "sand", 40.0  # s; defaults of make demo


def figure_3_7(vehicle: Vehicle) -> Figure:
    """Error of the moment of turning resistance without centrifugal force, (3.8), relative to (3.7)."""
    weight, length = vehicle.weight, vehicle.contact_length
    full = moment_with_centrifugal_force(weight, length, MU_L, lateral(vehicle))
    title = "Fig. 3.7: moment of turning resistance, (3.8) against (3.7)"
    return error_over_mu_l(full, triangular_moment(weight, length, MU_L), "(3.7)", title)


def figure_3_8(vehicle: Vehicle) -> Figure:
    """Error of the instantaneous centre to first order, relative to (3.6)."""
    full, first_order = (
        formula(vehicle.contact_length, MU_L, lateral(vehicle))
        for formula in (centre_point, centre_point_approximate)
    )
    title = "Fig. 3.8: instantaneous centre $x_s$, first order against (3.6)"
    return error_over_mu_l(full, first_order, "(3.6)", title)


def lateral(vehicle: Vehicle) -> float:
    """Lateral acceleration φ̇² B/2 of the fastest turn, m/s²."""
    return FAST_TURN**2 * vehicle.tread / 2.0


def error_over_mu_l(full: FloatArray, simple: FloatArray, equation: str, title: str) -> Figure:
    """A figure of the error of a simpler formula over ``MU_L``, and the range of normal soils."""
    figure, (axes,) = make_panels(1)
    axes.axvspan(*NORMAL_MU_L, color=BAND, zorder=0)
    axes.text(sum(NORMAL_MU_L) / 2.0, 0.06, "normal soils", transform=axes.get_xaxis_transform(), ha="center")
    axes.plot(MU_L, 100.0 * (full - simple) / full, color=COLOURS[2])
    label_axes(axes, title, "coefficient of lateral resistance $\\mu_l$", f"error (% of {equation})")
    axes.set_xlim(0.0, 1.5)
    return figure


def figure_3_9(vehicle: Vehicle) -> Figure:
    """Errors of the approximate thrust-slip relation (3.12) against (3.3), in slip and in thrust."""
    figure, (in_slip, in_thrust) = make_panels(2)
    length = vehicle.contact_length
    slip = np.geomspace(0.001, 1.0, 2000)
    for modulus, colour, dash in zip((0.006, 0.01, 0.025, 0.05), COLOURS, DASHES, strict=False):
        exact = thrust(slip, 1.0, modulus, length)
        approximate_slip = slip_of_thrust_approximate(exact, 1.0, modulus, length)
        line: dict[str, Any] = {"color": colour, "linestyle": dash, "label": f"K = {100 * modulus:g} cm"}
        in_slip.plot(100.0 * slip, 100.0 * (slip - approximate_slip) / approximate_slip, **line)
        # By (3.12) the thrust at this slip is exp(−K/(i l)) of the limit.
        approximate = np.exp(-modulus / (slip * length))
        in_thrust.plot(100.0 * slip, 100.0 * (approximate - exact) / exact, **line)
    label_axes(in_slip, "Fig. 3.9: slip, (3.3) against (3.12)", "slip (%)", "error of slip (% of (3.12))")
    label_axes(in_thrust, "The same for thrust at given slip", "slip (%)", "error of thrust (% of (3.3))")
    for axes in (in_slip, in_thrust):
        axes.axvline(4.0, color=GREY, linewidth=0.6)
        axes.axhspan(-10.0, 10.0, color=BAND, zorder=0)
        axes.set(xscale="log", xlim=(0.1, 100.0), ylim=(-80.0, 20.0))
        axes.xaxis.set_major_formatter("{x:g}")
    in_slip.text(4.4, -75.0, "4 %")
    in_slip.legend(loc="lower right")
    return figure


def thrust_slip_curves(vehicle: Vehicle) -> Figure:
    """(3.3) for one PC05 track on all soils with K; dots: straight driving on level ground."""
    figure, panels = make_panels(2)
    slip = np.linspace(-0.2, 0.6, 1601)
    soils = [soil for soil in load_soils().values() if soil.shear_modulus is not None]
    for axes, table in zip(panels, ("6.1", "2.1"), strict=True):
        chosen = [soil for soil in soils if (soil.name in TABLE_6_1) == (table == "6.1")]
        for soil, colour, dash in zip(chosen, COLOURS, DASHES, strict=False):
            draw_thrust(axes, vehicle, soil, slip, (colour, dash))
        axes.axvline(0.0, color=GREY, linewidth=0.6)
        axes.legend(loc="lower right")
        axes.set_xlim(-20.0, 60.0)
        label_axes(axes, f"Thrust of one PC05 track, Table {table}", "slip (%)", "thrust (kN)")
    return figure


def draw_thrust(axes: Axes, vehicle: Vehicle, soil: Soil, slip: FloatArray, line: tuple[str, Any]) -> None:
    """Draw one thrust-slip curve, and its point of straight motion if μ_r is known."""
    modulus, length = soil.value("shear_modulus"), vehicle.contact_length
    area = 2.0 * vehicle.track_width * length
    limit = thrust_limit(soil.cohesion, soil.friction_angle, area, vehicle.weight)
    colour, dash = line
    name = soil.name.replace("_", " ")
    axes.plot(
        100.0 * slip, thrust(slip, limit, modulus, length) / 1e3, color=colour, linestyle=dash, label=name
    )
    if soil.mu_r is not None:
        resistance = longitudinal_resistance(1.0, soil.mu_r, vehicle.weight)
        straight = slip_of_thrust(resistance, limit, modulus, length)
        axes.plot(100.0 * straight, resistance / 1e3, "o", color=colour, markersize=4)


def figure_6_1(vehicle: Vehicle) -> Figure:
    """Path and slip angle of the thesis' manoeuvre on the soils of Table 6.1."""
    figure, (path, angle) = make_panels(2)
    for run, line in thesis_runs(vehicle):
        path.plot(run.x, run.y, **line)
        angle.plot(run.t, 1000.0 * run.slip_angle, **line)
    label_axes(path, "Fig. 6.1: path", "x (m)", "y (m)")
    label_axes(angle, "Slip angle α", "time (s)", "slip angle (mrad)")
    path.set_aspect("equal")
    path.legend(loc="lower left")
    return figure


def figure_6_2(vehicle: Vehicle) -> Figure:
    """Slips of both tracks in the thesis' manoeuvre on the soils of Table 6.1."""
    figure, (left, right) = make_panels(2)
    for run, line in thesis_runs(vehicle):
        left.plot(run.t, 100.0 * run.left_slip, **line)
        right.plot(run.t, 100.0 * run.right_slip, **line)
    for axes, title in ((left, "Fig. 6.2: slip of the left track"), (right, "Slip of the right track")):
        label_axes(axes, title, "time (s)", "slip (%)")
        axes.set_ylim(-0.5, 8.0)  # the thesis' range; cuts a peak under 0.15 s at the start on clayey soil
    right.legend(loc="upper center")
    return figure


def thesis_runs(vehicle: Vehicle) -> Iterator[tuple[Truth, dict[str, Any]]]:
    """The forward simulation of §6.2.1 on each soil, and its line style."""
    scenario = load_scenario("thesis")
    for name, colour, dash in zip(TABLE_6_1, COLOURS, DASHES, strict=False):
        run = simulate(scenario, soil=name, mode="thesis", vehicle=vehicle)
        yield run, {"color": colour, "linestyle": dash, "label": name.replace("_", " ")}


FIGURES: Mapping[str, Callable[[Vehicle], Figure]] = {
    "fig_3_7": figure_3_7,
    "fig_3_8": figure_3_8,
    "fig_3_9": figure_3_9,
    "fig_6_1": figure_6_1,
    "fig_6_2": figure_6_2,
    "thrust_slip": thrust_slip_curves,
}


def draw_demo(output: Path) -> None:
    """The moving picture of what ``make demo`` drives, without its graph: no host is too busy for it."""
    p = load_emulator_parameters({"duration": DEMO_DURATION, "scenario": DEMO_SCENARIO, "soil": DEMO_SOIL})
    estimates = GrowingRows(ESTIMATE)
    with tempfile.TemporaryDirectory() as folder:
        record_drive(p, simulate_drive(p), path := Path(folder) / "demo")
        with open_bag(path) as bag:
            estimator = load_slip_parameters(bag_parameters(bag))
            collect = lambda part: estimates.add(part.estimates)  # noqa: E731
            result = replay(bag, estimator, InputFilters(), TRUE_ODOMETRY, None, collect)
    start_ns = START_NS + round(p.lead_in * 1e9)
    driven = {name: series.rows_since(start_ns) for name, series in result.series.items()}
    estimated = Series(sort_by_stamp(estimates.rows())).rows_since(start_ns)
    run = Run(estimated, driven[TRUE_ODOMETRY], driven[TRUE_SLIP], result.paths["dead_reckoning"])
    animate(run, load_vehicle().kinematics, output / "demo.gif")
    print(output / "demo.gif")


def main() -> None:
    """Draw all figures, or only the animation of the demo."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=OUTPUT, help="folder of the PNG files")
    parser.add_argument("--demo", action="store_true", help="the demo's picture alone")
    options = parser.parse_args()
    output: Path = options.output
    output.mkdir(parents=True, exist_ok=True)
    draw_demo(output)
    if options.demo:
        return
    vehicle = load_vehicle().whole()
    with style.context(STYLE):
        for name, make_figure in FIGURES.items():
            save_figure(make_figure(vehicle), output / f"{name}.png")
            print(output / f"{name}.png")
        for name, figure in run_figures(load_study_parameters({}), load_slip_parameters()):
            save_figure(figure, output / f"{name}.png")
            print(output / f"{name}.png")


if __name__ == "__main__":
    main()
