# SPDX-License-Identifier: Apache-2.0
"""How good the soil estimator is on a known truth: ``trackslip study --estimator soil``."""

from trackslip_sim.soil_study.score import run
from trackslip_sim.soil_study.trial import Trial, drive, estimates

__all__ = ["Trial", "drive", "estimates", "run"]
