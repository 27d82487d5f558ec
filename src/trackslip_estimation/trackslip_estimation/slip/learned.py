# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Learned values of a machine and its ground, without its pose: extract, decay, and start from them.

    x, P     means and covariance of the states that are kept            (n,), (n, n)
    μ, Σ     prior of the states by the parameters                       (n,), (n, n)
    T        correlation time of a state between runs                    s
    φ        e^(−age/T)

Each state ages as a first-order Gauss–Markov process about its prior: x ← μ + φ (x − μ), P ← φ P φᵀ +
(1 − φ φᵀ) Σ, by elements. ln of the weights of point masses decays to its prior by φ too. The decayed
values are the prior of the next run. The bag records them with the parameters; a replay starts from them.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.errors import InputError
from trackslip_common.parameters import to_flat
from trackslip_estimation.slip.config import ConfigRecord, make_config
from trackslip_estimation.slip.models.dispatch import MODELS
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.sources import MountableSource

if TYPE_CHECKING:
    from trackslip_estimation.slip.records import State


_UNLEARNED_PARTS = ("pose", "velocity_errors", "slips", "slip_angle")  # parts of a state that are not kept
_HOURS, _DAYS = 3600.0, 86400.0
_GROUND_LIFETIME = 8.0 * _HOURS  # T of ground states and of all noise: ground and GNSS conditions change
_MACHINE_LIFETIME = 180.0 * _DAYS
_LIFETIMES = {
    "gyro_bias": 4.0 * _HOURS,  # temperature
    "gyro_scale": _MACHINE_LIFETIME,
    "fix_delay": _MACHINE_LIFETIME,
    "asymmetry": _MACHINE_LIFETIME,
}
_ROUNDING = 1e-6  # of eigenvalues of correlations


@dataclass(frozen=True, eq=False)
class Learned:
    """Kept states and noise weights of one estimator."""

    machine: str  # digest of vehicle, sources and model
    mean: FloatArray  # (n,) in the order of ``LearnedContext.state_indices``
    stddev: FloatArray  # (n,)
    correlations: FloatArray  # (n, n)
    track_weights: FloatArray  # (TRACK_ERRORS, RATE_FACTORS) ln of the weights of s and a
    fix_weights: Mapping[str, FloatArray]  # (FIX_FACTORS,) ln of the weights of f, by source with fixes

    @property
    def is_finite(self) -> bool:
        """Whether all numbers are finite: only then they may be stored or used."""
        numbers = (self.mean, self.stddev, self.correlations, self.track_weights, *self.fix_weights.values())
        return all(bool(np.isfinite(array).all()) for array in numbers)

    @property
    def covariance(self) -> FloatArray:
        """P (n, n)."""
        return np.asarray(self.correlations * np.outer(self.stddev, self.stddev))


class OtherMachineError(InputError):
    """Learned values belong to another machine; the second argument is its digest."""

    @property
    def machine(self) -> str:
        """Digest of that machine, unchecked text."""
        return str(self.args[1])

    def __str__(self) -> str:
        return str(self.args[0])


class LearnedContext(NamedTuple):
    """Context of learned numbers, by the parameters; read-only."""

    machine: str  # digest of the vehicle, its sources and the model
    state_indices: Mapping[str, int]  # learned state → index in the state vector, in the model's order
    prior: Learned
    constants: Any  # record of ``adaptation.CONSTANTS``
    has_track_error: bool  # whether the model estimates one
    stamp_errors: Mapping[str, float]  # σ_t of each source of poses, s


def learned_context(p: SlipEstimatorParameters) -> LearnedContext:
    """Context of the values that an estimator with these parameters learns."""
    c, states, machine = make_config(p)[0], _learned_states(p), _machine_digest(p)
    indices, n = list(states.values()), c["adaptation"]
    weights = np.tile(n["rate_prior"], (len(n["track_variances"]), 1))
    stddev, correlations = _stddev_and_correlations(c["prior_covariance"][np.ix_(indices, indices)])
    prior = Learned(machine, c["prior_mean"][indices], stddev, correlations, weights, {})
    has_track_error = hasattr(MODELS[p.model], "velocity_error_constants")
    stamp_errors = {name: source.stamp_error for name, source in p.poses().items()}
    return LearnedContext(machine, states, prior, n, has_track_error, stamp_errors)


def _machine_digest(p: SlipEstimatorParameters) -> str:
    content = {
        "vehicle": to_flat(p.vehicle),
        "model": p.model,
        "poses": {
            name: (source.lever[:2], source.stamp_error, *_mount_for_digest(source))
            for name, source in p.poses().items()
        },
        "gyros": {
            name: (
                imu.sign,
                imu.scale,
                *((imu.mounting,) if imu.mounting and not imu.mounting_from_tf else ()),
                *_mount_for_digest(imu),
            )
            for name, imu in p.gyros().items()
        },
        "least_track_error": p.adaptation.least_track_error,
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]


def _mount_for_digest(source: MountableSource) -> tuple[str, ...]:
    """Part of the digest for a sensor on the upper structure; else ()."""
    return (source.mount,) if source.above else ()


def _learned_states(p: SlipEstimatorParameters) -> dict[str, int]:
    states: dict[str, int] = {}
    for part in MODELS[p.model].PARTS:
        places = range(part.at.start, part.at.stop)
        if part.name not in _UNLEARNED_PARTS:
            names = [f"{part.name}_{k + 1}" for k in range(len(places))] if len(places) > 1 else [part.name]
            states |= dict(zip(names, places, strict=True))
    return states


def extract_learned(state: State, context: LearnedContext, sources: Mapping[str, int]) -> Learned:
    """Extract learned values from a record of ``STATE``; ``sources``: name → number."""
    adaptation = state["adaptation"]
    indices = list(context.state_indices.values())
    weights = {name: adaptation["fix_log_weights"][sources[name]] for name in context.stamp_errors}
    return Learned(
        context.machine,
        state["mean"][indices],
        *_stddev_and_correlations(state["covariance"][np.ix_(indices, indices)]),
        adaptation["log_weights"].copy(),
        {name: log_weights.copy() for name, log_weights in weights.items() if log_weights.any()},
    )


def decay_to_prior(learned: Learned, age_s: float, context: LearnedContext) -> Learned:
    """Decay learned values towards the prior over ``age_s`` seconds, at least 0."""
    prior, fix_prior = context.prior, context.constants["fix_prior"]
    lifetimes = np.array([_LIFETIMES.get(name, _GROUND_LIFETIME) for name in context.state_indices])
    phi, noise_share = np.exp(-age_s / lifetimes), math.exp(-age_s / _GROUND_LIFETIME)
    forgotten = -np.expm1(-age_s * np.add.outer(1.0 / lifetimes, 1.0 / lifetimes))
    stddev, correlations = _stddev_and_correlations(
        np.outer(phi, phi) * learned.covariance + forgotten * prior.covariance
    )
    return replace(
        learned,
        mean=prior.mean + phi * (learned.mean - prior.mean),
        stddev=stddev,
        correlations=correlations,
        track_weights=prior.track_weights + noise_share * (learned.track_weights - prior.track_weights),
        fix_weights={
            name: fix_prior + noise_share * (w - fix_prior) for name, w in learned.fix_weights.items()
        },
    )


def set_learned_priors(
    learned: Learned, config: ConfigRecord, context: LearnedContext, sources: Mapping[str, int]
) -> None:
    """Set the priors of ``config``, (1,) of ``CONFIG``, to learned values instead of the parameters' ones."""
    c, indices = config[0], list(context.state_indices.values())
    c["prior_mean"][indices] = learned.mean
    c["prior_covariance"][np.ix_(indices, indices)] = learned.covariance
    c["prior_variance"] = np.diag(c["prior_covariance"])
    start, n = c["start"], c["adaptation"]
    masses = weights_of(learned.track_weights)
    start["log_weights"] = learned.track_weights
    start["track_variance"] = masses.sum(axis=1) @ n["track_variances"]
    start["rate_factor"] = masses.sum(axis=0) @ n["rate_factors"]
    start["fix_factors"] = 1.0
    for name, log_weights in learned.fix_weights.items():
        start["fix_log_weights"][sources[name]] = log_weights
        start["fix_factors"][sources[name]] = weights_of(log_weights) @ n["fix_factors"]
    c["resumes"] = True


def weights_of(log_weights: FloatArray) -> FloatArray:
    """Weights of point masses, normalised to a sum of 1."""
    masses = np.exp(log_weights - log_weights.max())
    return np.asarray(masses / masses.sum())


def to_tree(learned: Learned, context: LearnedContext) -> dict[str, Any]:
    """Convert to nested mappings and lists of numbers, for YAML; ``from_tree`` restores the same bits."""
    numbers = zip(context.state_indices, learned.mean.tolist(), learned.stddev.tolist(), strict=True)
    return {
        "machine": learned.machine,
        "states": {name: {"value": value, "stddev": deviation} for name, value, deviation in numbers},
        "correlations": [learned.correlations[k, :k].tolist() for k in range(1, len(learned.mean))],
        "track_error_ln_weights": learned.track_weights.tolist(),
        "fix_noise_ln_weights": {name: w.tolist() for name, w in learned.fix_weights.items()},
    }


def from_tree(tree: Any, context: LearnedContext) -> Learned:
    """Restore the output of ``to_tree`` of the same machine.

    Raises:
        InputError: the tree is of another machine, or not of this form.
    """
    if not isinstance(tree, Mapping) or not isinstance(tree.get("machine"), str):
        raise InputError("it contains no learned values")
    if tree["machine"] != context.machine:
        raise OtherMachineError(
            "it is of another vehicle, or of other sources or another model", tree["machine"]
        )
    names, prior = list(context.state_indices), context.prior
    try:
        states, n = tree["states"], len(names)
        if list(states) != names:
            raise ValueError("states")
        mean = np.array([float(states[name]["value"]) for name in names])
        stddev = np.array([float(states[name]["stddev"]) for name in names])
        correlations = np.eye(n)
        for k, row in enumerate(tree["correlations"], 1):
            correlations[k, :k] = correlations[:k, k] = np.array(row, np.float64).reshape(k)
        track = np.array(tree["track_error_ln_weights"], np.float64).reshape(prior.track_weights.shape)
        fixes = {
            name: np.array(log_weights, np.float64).reshape(context.constants["fix_prior"].shape)
            for name, log_weights in tree["fix_noise_ln_weights"].items()
            if name in context.stamp_errors
        }
        arrays = (mean, stddev, correlations, track, *fixes.values())
        if not all(np.all(np.abs(numbers) < 1e9) for numbers in arrays) or np.any(stddev < 0.0):
            raise ValueError("numbers")
        if np.linalg.eigvalsh(correlations)[0] < -_ROUNDING:
            raise ValueError("correlations")
    except (ValueError, TypeError, KeyError, OverflowError, AttributeError) as error:
        raise InputError("its values do not fit the states of this version") from error
    return Learned(tree["machine"], mean, stddev, correlations, track, fixes)


def _stddev_and_correlations(P: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Standard deviations (n,) and correlations (n, n) of a covariance (n, n)."""
    stddev = np.sqrt(np.diag(P))
    divisor = np.where(stddev > 0.0, stddev, 1.0)
    lower = np.tril(P / np.outer(divisor, divisor), -1)
    return stddev, lower + lower.T + np.eye(len(stddev))
