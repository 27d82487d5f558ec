# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The Python interface of Trackslip: pose, slips and soil of a tracked machine from its logs, as arrays.

    import trackslip as ts
    result = ts.replay(ts.example())
    result.estimates.save("estimates.csv")

``__all__`` lists the public names; CONTRIBUTING.md states how versions may change them. All other modules and
packages may change with each version. Units are SI, angles rad, stamps ns. A covariance refers to the columns
of the array after which it is named.
"""

from trackslip._check import SetupCheck, check
from trackslip._estimates import Estimates
from trackslip._estimator import Estimator
from trackslip._log import Log, example, load
from trackslip._replay import Result, replay
from trackslip_common import __version__
from trackslip_common.errors import InputError

__all__ = [
    "Estimates",
    "Estimator",
    "InputError",
    "Log",
    "Result",
    "SetupCheck",
    "__version__",
    "check",
    "example",
    "load",
    "replay",
]
