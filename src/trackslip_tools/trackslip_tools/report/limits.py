# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The limits of a report's verdict: ``config/report.yaml``, or a file of the user's own over it."""

from collections.abc import Sequence
from dataclasses import dataclass

from trackslip_common.config_files import config_file, load_parameters, node_parameters, read_yaml
from trackslip_common.errors import InputError
from trackslip_common.parameters import Parameters, parameter

SECTION = "report"
DEFAULT_FILES = ("report.yaml",)


@dataclass(frozen=True, kw_only=True)
class VerdictLimits(Parameters):
    """See ``config/report.yaml``."""

    position: float = parameter("largest RMSE of the position", unit="m", gt=0.0)
    encoders: float = parameter("largest RMSE of the position, over that of encoders alone", gt=0.0)
    slip: float = parameter("largest RMSE of the slips", gt=0.0)
    least_consistency: float = parameter("least ratio of errors to what is claimed of them", ge=0.0, lt=1.0)
    most_consistency: float = parameter("largest ratio of errors to what is claimed of them", gt=1.0)
    lost: float = parameter("largest share of messages lost", ge=0.0, lt=1.0)
    refused: float = parameter("largest share of measurements not used", ge=0.0, lt=1.0)
    slip_stddev: float = parameter("standard deviation up to which a slip counts as known", gt=0.0)


def load_limits(files: Sequence[str] = ()) -> VerdictLimits:
    """Those of ``config/``, with these files over them.

    Raises:
        InputError: a file is missing or says nothing of a report, a name is unknown, or a value is refused.
    """
    layers = []
    for name in files:
        path = config_file(name)
        layers.append(node_parameters(read_yaml(path), SECTION, str(path)))
        if not layers[-1]:
            raise InputError(f"{path}: no limits; accepted: a section '{SECTION}' as in config/report.yaml")
    return load_parameters(VerdictLimits, SECTION, DEFAULT_FILES, *layers)
