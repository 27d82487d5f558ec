# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Texts of the competing explanations: on /diagnostics, in reports, on the live page."""

from dataclasses import replace

import numpy as np
from fixtures.drawn_machine import FIX, Machine, drive, parameters

from trackslip_estimation.nodes.estimator_health import estimator_health
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.events import Event
from trackslip_estimation.slip.explanations import (
    NOTHING_HAPPENED,
    AcceptedEvent,
    CompetingExplanations,
    Explanation,
    recent_events_text,
    sentence,
)
from trackslip_estimation.slip.measurements import PoseFix
from trackslip_estimation.slip.source_watch import SourceWatch

S = 1_000_000_000
OFF = Explanation("gnss_pose is 1.0 m off", 0.9, 8 * S)
MOVED = Explanation("the machine was moved", 0.1, 8 * S, is_ongoing=False)
CALM = Explanation(NOTHING_HAPPENED, 0.0, 10 * S)


def test_explanations_that_compete_are_listed_with_their_probabilities() -> None:
    text = "two explanations for 2.0 s: gnss_pose is 1.0 m off (90 %), the machine was moved (10 %)"
    assert CompetingExplanations(10 * S, (OFF, MOVED)).text == text


def test_single_explanation_states_its_duration() -> None:
    assert CompetingExplanations(10 * S, (OFF,)).text == "gnss_pose is 1.0 m off, for 2.0 s"
    assert CompetingExplanations(10 * S, (MOVED,)).text == "the machine was moved, 2.0 s ago"


def test_three_explanations_are_named_and_the_others_summed() -> None:
    many = [
        Explanation(name, p, 0) for name, p in (("a", 0.5), ("b", 0.2), ("c", 0.15), ("d", 0.1), ("e", 0.05))
    ]
    assert sentence(many, 1.0) == "five explanations for 1.0 s: a (50 %), b (20 %), c (15 %), others (15 %)"


def test_alternatives_of_a_few_percent_are_not_stated() -> None:
    assert (
        CompetingExplanations(
            10 * S, (CALM._replace(probability=0.95), OFF._replace(probability=0.05))
        ).number_competing
        == 0
    )
    assert (
        CompetingExplanations(
            10 * S, (CALM._replace(probability=0.6), OFF._replace(probability=0.4))
        ).number_competing
        == 2
    )
    assert CompetingExplanations(10 * S, ()).text == ""


def test_explanation_without_an_event_does_not_shorten_the_duration() -> None:
    assert CompetingExplanations(10 * S, (OFF, CALM._replace(probability=0.1))).seconds == 2.0


def test_last_events_have_stamps_and_no_single_outliers() -> None:
    happened = [
        AcceptedEvent(40 * S, Event.OFFSET, "gnss_pose", 0.9),
        AcceptedEvent(45 * S, Event.OUTLIER, "gnss_pose", 0.9),
        AcceptedEvent(50 * S + S // 4, Event.RECOVERED, "gnss_pose", 0.9),
    ]
    assert (
        recent_events_text(happened)
        == "40.00 gnss_pose is off; 50.25 gnss_pose has recovered; probability 90 %"
    )
    assert recent_events_text([]) == "none"


def test_recovered_source_is_not_an_explanation() -> None:
    """Multipath of 1 m from 20 to 30 s."""
    recording = drive(Machine(duration=45.0, track_error=0.05, fix_noise=0.03, fix_stated=0.03))
    gnss = {"sources.box_pose.fault_rate": 1 / 300, "sources.box_pose.jump_rate": 1 / 3000}
    estimator = SlipEstimator(parameters(**gnss))
    watch = SourceWatch(estimator.parameters.timeouts_ns())
    counts, texts = {}, {}
    for m in recording.measurements:
        t = m.stamp_ns / S - 1.0
        if isinstance(m, PoseFix) and 20.0 <= t < 30.0:
            m = replace(m, pose=m.pose + np.array((0.8, 0.6, 0.0)))
        watch.add(estimator.process(m)[0])
        counts[t], texts[t] = (
            estimator.competing_explanations.number_competing,
            estimator.competing_explanations.text,
        )
    assert all(counts[t] >= 1 for t in counts if 23.0 < t < 29.5)
    assert any(
        text.startswith("two explanations for") and f"{FIX} is 1.0 m off" in text for text in texts.values()
    )
    assert all(counts[t] == 0 for t in counts if t > 33.0 or 5.0 < t < 19.5)
    values = estimator_health(estimator, watch, 0.0, {}).values
    assert values["explanations"] == "none needed"
    assert f"{FIX} is off" in values["last events"]
    assert f"{FIX} has recovered" in values["last events"]


def test_unknown_heading_is_reported_until_it_is_found() -> None:
    recording = drive(Machine(duration=40.0, fix_noise=0.03, fix_stated=0.03))
    estimator = SlipEstimator(parameters(initial_yaw_stddev=0.0))
    texts = []
    for m in recording.measurements:
        estimator.process(m)
        texts.append(estimator.competing_explanations.text)
    unknown = [text for text in texts if "the heading is being found from fixes" in text]
    assert unknown
    assert texts[-1] == ""
    assert "the heading was wrong" not in " ".join(texts)
