# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Orientation of the box: four hypotheses, a quarter turn apart, weighted from scan to scan.

    h_k   heading of hypothesis k = 0 … 3, about k quarter turns from that tracked        rad
    w_k   its probability
    ψ̂, s  predicted heading; standard deviation of h_k − ψ̂                                rad
    E_k   evidence: the likelihood of a scan's beams, integrated over the poses about h_k
    Λ     log odds of a quarter turn, from the E_k of all scans

After half a turn the box looks the same, and after a quarter nearly so: the sides differ by little, and a few
beams do not distinguish them. The first weights are therefore those of the predicted heading,

    w_k ∝ Σ_j w_j N(h_k; ψ̂ + j π/2, s²),  wrapped.

An ambiguity after an absence remains until Λ resolves it. No single scan suffices, and scans from one place
count once: the same beams hit and miss in each of them. Until then a fix covers all hypotheses.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray

QUARTER_TURN = np.pi / 2.0
CERTAIN_WEIGHTS: FloatArray = np.array([1.0, 0.0, 0.0, 0.0])
NEGLIGIBLE_PROBABILITY = 1e-4  # probability of the other headings below which one is certain
REFUTED_PROBABILITY = 1e-6  # probability below which the other sides are not fitted
LARGEST_STEP = 1.0  # of Λ in one scan
# rad, standard deviation of the prediction from which the sides are unknown
LARGEST_HEADING_STDDEV = 0.5 * np.pi / 4.0

ERROR_TIME = 10.0  # s, correlation time of the error of a hypothesis
LEAST_INTERVAL = 0.01  # s between fixes
_TURNS = QUARTER_TURN * np.arange(4.0)
_WRAPS = 2.0 * np.pi * np.arange(-2.0, 3.0)[:, np.newaxis, np.newaxis]


@dataclass(frozen=True, eq=False)
class Mode:
    """One hypothesis after a scan: pose (3,) of base_link in odom, its covariance (3, 3), log E."""

    pose: FloatArray
    covariance: FloatArray
    log_evidence: float


@dataclass(frozen=True)
class SideEvidence:
    """Λ: ``settled`` from earlier places, plus the mean of ``count`` scans at the present ``x``, ``y``, m."""

    settled: float = 0.0
    mean: float = 0.0
    count: int = 0
    x: float = 0.0
    y: float = 0.0

    @property
    def log_odds(self) -> float:
        """Λ."""
        return self.settled + float(np.clip(self.mean, -LARGEST_STEP * self.count, LARGEST_STEP * self.count))

    def update(self, log_ratio: float, pose: FloatArray, step: float) -> "SideEvidence":
        """Return Λ after one more scan of the box at ``pose`` (3,), where beams are ``step`` apart, m."""
        if self.count == 0 or np.hypot(pose[0] - self.x, pose[1] - self.y) > step:
            return SideEvidence(self.log_odds, log_ratio, 1, float(pose[0]), float(pose[1]))
        count = self.count + 1
        return SideEvidence(self.settled, self.mean + (log_ratio - self.mean) / count, count, self.x, self.y)

    def rotate_quarter(self) -> "SideEvidence":
        """Return Λ for the heading a quarter turn away."""
        return SideEvidence(-self.settled, -self.mean, self.count, self.x, self.y)


def heading_prior(turned: FloatArray, variance: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the probabilities (M,) of headings prior to the evidence of their scan.

    turned, variance: (M,), the headings minus ψ̂, and s², rad and rad²; weights: (4,) of ψ̂ and the headings
    one, two and three quarter turns from it.
    """
    offsets = turned - _TURNS[:, np.newaxis] + _WRAPS
    log_weights = np.log(np.maximum(weights, 1e-300))[:, np.newaxis]
    joint = _normalise(log_weights - 0.5 * (offsets**2 / variance + np.log(variance)))
    return np.asarray(joint.sum(axis=(0, 1)))


def sides_are_known(turned: float, variance: float, weights: FloatArray) -> bool:
    """Whether the prior of a heading, as in ``heading_prior``, refutes those a quarter turn from it."""
    probabilities = heading_prior(turned + _TURNS, np.full(4, variance), weights)
    return bool(probabilities[1::2].sum() < REFUTED_PROBABILITY)


def add_evidence(weights: FloatArray, log_odds: float) -> FloatArray:
    """Return probabilities (4,) updated with the log odds of the second and fourth against the others."""
    logs = np.log(np.maximum(weights, 1e-300)) + np.array((0.0, log_odds, 0.0, log_odds))
    return _normalise(logs)


def _normalise(logs: FloatArray) -> FloatArray:
    """Return probabilities from their logarithms, known up to a constant."""
    likelihoods = np.exp(logs - logs.max())
    return np.asarray(likelihoods / likelihoods.sum())


class HeadingUpdate(NamedTuple):
    """Hypotheses after a scan."""

    modes: list[Mode]  # most probable first
    probabilities: FloatArray  # (4,) of each
    headings: "Headings"  # state for the next scan


@dataclass(frozen=True, eq=False)
class Headings:
    """State of the hypotheses, the first of which is tracked: w (4,) without Λ, and Λ."""

    weights: FloatArray
    evidence: SideEvidence

    def update(self, modes: list[Mode], heading: float, variance: float, step: float) -> HeadingUpdate:
        """Return the hypotheses after a scan, with modes about ``heading`` and its three quarter turns.

        ``variance``: of the predicted heading, rad²; ``step``: as in ``SideEvidence.update``.
        """
        turned = np.array([mode.pose[2] for mode in modes]) - heading
        weights = heading_prior(
            turned, variance + np.array([mode.covariance[2, 2] for mode in modes]), self.weights
        )
        ratio = float(np.nan_to_num(modes[1].log_evidence - modes[0].log_evidence))
        evidence = self.evidence if variance < LARGEST_HEADING_STDDEV**2 else SideEvidence()
        evidence = evidence.update(ratio, modes[0].pose, step)
        posterior = add_evidence(weights, evidence.log_odds)
        sides = np.array((posterior[::2].sum(), posterior[1::2].sum()))
        if sides.min() < NEGLIGIBLE_PROBABILITY:
            posterior = posterior * np.tile(sides > 0.5, 2)
            weights = posterior = posterior / posterior.sum()
            evidence = SideEvidence()
        first = int(np.argmax(posterior))
        next_headings = Headings(
            np.roll(weights, -first), evidence.rotate_quarter() if first % 2 else evidence
        )
        return HeadingUpdate(modes[first:] + modes[:first], np.roll(posterior, -first), next_headings)


def mix_modes(modes: list[Mode], weights: FloatArray, elapsed: float) -> tuple[FloatArray, FloatArray]:
    """Return pose (3,) and covariance (3, 3) of the mixture of modes; the heading is that of the first.

    ``elapsed``: since the previous fix, s. Errors of consecutive fixes are correlated: the spread of the
    positions counts once in ``ERROR_TIME``. Ambiguous headings are not averaged: two that are a quarter turn
    apart have no mean. The heading variance puts each of them within two standard deviations.
    """
    offsets = np.array([mode.pose - modes[0].pose for mode in modes])
    offsets[:, 2] -= 2.0 * np.pi * np.round(offsets[:, 2] / (2.0 * np.pi))
    mean = weights @ offsets
    mean[2] = 0.0
    spread = offsets - mean
    spread[:, :2] *= np.sqrt(max(ERROR_TIME / max(elapsed, LEAST_INTERVAL), 1.0))
    covariance = sum(w * m.covariance for w, m in zip(weights, modes, strict=True))
    covariance = covariance + (weights[:, np.newaxis] * spread).T @ spread
    farthest = np.abs(offsets[weights > NEGLIGIBLE_PROBABILITY, 2]).max(initial=0.0)
    if farthest > 0.5 * QUARTER_TURN:
        covariance[2, 2] = max(covariance[2, 2], (0.5 * farthest) ** 2)
    return modes[0].pose + mean, covariance
