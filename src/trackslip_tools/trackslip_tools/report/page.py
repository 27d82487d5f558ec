# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Renders plots and tables as one self-contained HTML page."""

from collections.abc import Sequence
from importlib import resources
from itertools import repeat
from typing import Any

from bokeh.core.validation import silence
from bokeh.core.validation.warnings import MISSING_RENDERERS
from bokeh.document import Document
from bokeh.embed import file_html
from bokeh.events import MouseMove, Tap
from bokeh.models import CustomJS, Span
from bokeh.plotting import figure
from bokeh.resources import INLINE
from jinja2 import Environment, PackageLoader

from trackslip_tools.report.headline import facts_of
from trackslip_tools.report.innovations import innovation_panels
from trackslip_tools.report.panel import COLOURS, DARK, GREY
from trackslip_tools.report.panels import error_panels, ground_panels, learned_panels, motion_panels
from trackslip_tools.report.path_plot import PathPlot, path_plot
from trackslip_tools.report.plots import strip_plot, time_plot, time_range
from trackslip_tools.report.run import Run, align_runs, first_runs_of_bags
from trackslip_tools.report.tables import (
    differing_rows,
    event_rows,
    learned_rows,
    parameter_rows,
    rejection_rows,
    run_facts,
    topic_rows,
)
from trackslip_tools.report.timeline import events_of, message_strips, strips
from trackslip_tools.report.verdict import VerdictLimits, verdicts

_SAMPLES = 4000  # per curve, in a report of up to two runs; more runs share the same total
_SHARING = 2
_INITIAL_PLOTS = 4  # plots drawn before the page is shown; report.js adds the others one by one
_TIME, _TIME_OF_DRIVING = "time, s", "time from the start of driving, s"

silence(MISSING_RENDERERS)  # a run without poses has an empty plan


def render(runs: Sequence[Run], limits: VerdictLimits) -> str:
    """The HTML page of one run, or of several side by side; times of several bags start with driving."""
    runs = align_runs(runs)
    samples = _SAMPLES * _SHARING // max(len(runs), _SHARING)
    x_range = time_range([run.recording for run in runs])
    path = path_plot(runs, samples)
    sections = {"What happened": [strip_plot(strip, x_range, samples) for strip in strips(runs)]}
    sections |= {
        name: [time_plot(panel, x_range, samples) for panel in panels]
        for name, panels in (
            ("Errors", error_panels(runs)),
            ("Motion", motion_panels(runs)),
            ("Ground", ground_panels(runs)),
            ("Learned", learned_panels(runs)),
            ("Innovations", innovation_panels(runs)),
        )
    }
    sections["Messages"] = [strip_plot(strip, x_range, samples) for strip in message_strips(runs)]
    sections = {name: plots for name, plots in sections.items() if plots}
    for plots in sections.values():
        plots[-1].xaxis.axis_label = _TIME if len(first_runs_of_bags(runs)) == 1 else _TIME_OF_DRIVING
    time_plots = [plot for plots in sections.values() for plot in plots]
    for number, plot in enumerate(time_plots):
        plot.name, plot.visible = f"time-{number}", number < _INITIAL_PLOTS
    _link_cursor(time_plots, path)
    environment = Environment(loader=PackageLoader(__package__), autoescape=True, trim_blocks=True)
    document = Document()
    with document.models.freeze():  # avoids that Bokeh walks through all linked models again for each plot
        for plot in (path.plot, *time_plots):
            document.add_root(plot)
    page: str = file_html(
        document,
        INLINE,
        title=f"Trackslip: {', '.join(run.label for run in runs)}",
        template=environment.get_template("page.html"),
        template_variables=_template_variables(runs, limits, sections),
    )
    return page


def _link_cursor(time_plots: Sequence[figure], path: PathPlot) -> None:
    """Link one cursor across all plots over time with the machine's marker on the path."""
    spans = [Span(dimension="height", line_color=GREY, visible=False) for _ in time_plots]
    paths, markers = [track.path for track in path.tracks], [track.marker for track in path.tracks]
    shared = {"spans": spans, "paths": paths, "markers": markers}
    code = resources.files(__package__).joinpath("templates", "cursor.js").read_text(encoding="utf-8")
    for plot, span in zip(time_plots, spans, strict=True):
        plot.add_layout(span)
        _add_pointer_callback(plot, CustomJS(args={"on_path": False, **shared}, code=code))
    _add_pointer_callback(path.plot, CustomJS(args={"on_path": True, **shared}, code=code))


def _add_pointer_callback(plot: figure, callback: CustomJS) -> None:
    """Run a callback when the mouse moves over a plot, and when a finger taps it."""
    for event in (MouseMove, Tap):
        plot.js_on_event(event, callback)


def _template_variables(
    runs: Sequence[Run], limits: VerdictLimits, sections: dict[str, list[figure]]
) -> dict[str, Any]:
    parameters = parameter_rows(runs)
    checks = [verdicts(run, limits) for run in runs]
    events = [events_of(run) for run in runs]
    heads = [facts_of(*of) for of in zip(runs, repeat(limits), checks, events)]
    return {
        "runs": [run_facts(run, colour) for run, colour in zip(runs, COLOURS, strict=False)],
        "facts": [*zip(*heads, strict=True)],
        "events": [(run.label, event_rows(of_run)) for run, of_run in zip(runs, events, strict=True)],
        "is_aligned": len(first_runs_of_bags(runs)) > 1,
        "verdicts": [(name, [of_run[name] for of_run in checks]) for name in checks[0]],
        "learned": [(run.label, learned_rows(run)) for run in runs],
        "sections": sections,
        "topics": [(run.label, topic_rows(run)) for run in first_runs_of_bags(runs)],
        "rejections": [(run.label, rejection_rows(run)) for run in runs],
        "differences": differing_rows(parameters),
        "parameters": parameters,
        "dark": DARK,
    }
