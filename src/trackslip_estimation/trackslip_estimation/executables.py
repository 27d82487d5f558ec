# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Entry points of the estimation nodes: each loads its module only when called (see ``start``)."""

from trackslip_common.start import start


def box_localizer() -> None:
    """See ``trackslip_estimation.nodes.box_localizer``."""
    start("trackslip_estimation.nodes.box_localizer")


def gnss_localizer() -> None:
    """See ``trackslip_estimation.nodes.gnss_localizer``."""
    start("trackslip_estimation.nodes.gnss_localizer")


def slip_estimator() -> None:
    """See ``trackslip_estimation.nodes.slip_estimator``."""
    start("trackslip_estimation.nodes.slip_estimator")


def soil_estimator() -> None:
    """See ``trackslip_estimation.nodes.soil_estimator``."""
    start("trackslip_estimation.nodes.soil_estimator")


def record() -> None:
    """See ``trackslip_bags.nodes.record``."""
    start("trackslip_bags.nodes.record")
