# SPDX-License-Identifier: Apache-2.0
"""Puts plots and tables on one page of HTML that holds all it needs."""

from collections.abc import Sequence
from importlib import resources
from typing import Any

from bokeh.embed import file_html
from bokeh.events import MouseMove
from bokeh.models import CustomJS, Range1d, Span
from bokeh.plotting import figure
from bokeh.resources import INLINE
from jinja2 import Environment, PackageLoader

from trackslip_tools.report.ground_panels import ground_panels
from trackslip_tools.report.innovations import innovation_panels
from trackslip_tools.report.learned_panels import learned_panels, learned_rows
from trackslip_tools.report.motion_panels import error_panels, motion_panels
from trackslip_tools.report.panel import DARK, GREY
from trackslip_tools.report.path_plot import PathPlot, path_plot
from trackslip_tools.report.plots import messages_plot, time_plot, time_range
from trackslip_tools.report.run import Run, recordings
from trackslip_tools.report.tables import (
    differing,
    parameter_rows,
    rejection_rows,
    run_facts,
    topic_rows,
    verdict_rows,
)

_SAMPLES = 4000  # of a curve, in a report of one or two runs; more runs share the same room
_SHARING = 2


def render(runs: Sequence[Run]) -> str:
    """The page about one run, or about several side by side."""
    samples = _SAMPLES * _SHARING // max(len(runs), _SHARING)
    x_range = time_range([run.recording for run in runs])
    path = path_plot(runs, samples)
    sections = {
        name: [time_plot(panel, x_range, samples) for panel in panels]
        for name, panels in (
            ("Errors", error_panels(runs)),
            ("Motion", motion_panels(runs)),
            ("Ground", ground_panels(runs)),
            ("Learned", learned_panels(runs)),
            ("Innovations", innovation_panels(runs)),
        )
    }
    sections["Messages"] = _messages(runs, x_range, samples)
    sections = {name: plots for name, plots in sections.items() if plots}
    for plots in sections.values():
        plots[-1].xaxis.axis_label = "time, s"
    time_plots = [plot for plots in sections.values() for plot in plots]
    for number, plot in enumerate(time_plots):
        plot.name = f"time-{number}"
    _link(time_plots, path)
    environment = Environment(loader=PackageLoader(__package__), autoescape=True, trim_blocks=True)
    page: str = file_html(
        [path.plot, *time_plots],
        INLINE,
        title=f"Trackslip: {', '.join(run.label for run in runs)}",
        template=environment.get_template("page.html"),
        template_variables=_variables(runs, sections),
    )
    return page


def _messages(runs: Sequence[Run], x_range: Range1d, samples: int) -> list[figure]:
    plots = []
    for run in recordings(runs):
        title = "Messages (where they are missing: orange)"
        title = title if len(runs) == 1 else f"{title}, {run.label}"
        plots.append(messages_plot(run.recording, title, x_range, samples))
    return plots


def _link(time_plots: Sequence[figure], path: PathPlot) -> None:
    """One cursor across all plots over time, and the machine on the path at that time."""
    spans = [Span(dimension="height", line_color=GREY, visible=False) for _ in time_plots]
    tracks = {
        "paths": [track.path for track in path.tracks],
        "markers": [track.marker for track in path.tracks],
    }
    code = _text("cursor.js")
    for plot, span in zip(time_plots, spans, strict=True):
        plot.add_layout(span)
        plot.js_on_event(MouseMove, CustomJS(args={"spans": spans, "on_path": False, **tracks}, code=code))
    path.plot.js_on_event(MouseMove, CustomJS(args={"spans": spans, "on_path": True, **tracks}, code=code))


def _variables(runs: Sequence[Run], sections: dict[str, list[figure]]) -> dict[str, Any]:
    parameters = parameter_rows(runs)
    return {
        "runs": run_facts(runs),
        "verdicts": verdict_rows(runs),
        "learned": [(run.label, learned_rows(run)) for run in runs],
        "sections": sections,
        "topics": [(run.label, topic_rows(run)) for run in recordings(runs)],
        "rejections": [(run.label, rejection_rows(run)) for run in runs],
        "differences": differing(parameters),
        "parameters": parameters,
        "dark": DARK,
    }


def _text(name: str) -> str:
    return resources.files(__package__).joinpath("templates", name).read_text(encoding="utf-8")
