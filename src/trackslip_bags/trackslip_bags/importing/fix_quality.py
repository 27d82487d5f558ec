# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Quality of a GGA sentence: status of a NavSatFix, and the least error of a position.

Source: NMEA 0183, GGA. 1 single, 2 differential, 3 precise service, 4 fixed and 5 float ambiguities, 9 SBAS.
"""

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.config_files import load_parameters
from trackslip_estimation.gnss.parameters import NODE, AssumedStddevs, GnssLocalizerParameters

_STATUS = {1: 0, 2: 1, 3: 0, 4: 2, 5: 2, 9: 2}  # NavSatStatus: fix, SBAS, GBAS
_NO_FIX = -1
_AMBIGUITIES_FIXED = 4


def status_of(quality: FloatArray) -> FloatArray:
    """(n,) status of a NavSatFix by quality (n,); −1 where it is nan, or none of a fix."""
    return np.array([_STATUS.get(one, _NO_FIX) for one in _numbers(quality)], np.float64)


def assumed_stddevs() -> AssumedStddevs:
    """Standard deviations of fixes without a covariance, as ``gnss_localizer`` assumes them."""
    return load_parameters(GnssLocalizerParameters, NODE, (f"{NODE}.yaml",)).assumed_stddev


def least_variances(quality: FloatArray) -> FloatArray:
    """(n,) m², least variance of a position by axis; 0 where the ambiguities are fixed."""
    assumed = assumed_stddevs()
    of_status = {0: assumed.single, 1: assumed.differential, 2: assumed.rtk}
    stddevs = {q: of_status[status] for q, status in _STATUS.items()} | {_AMBIGUITIES_FIXED: 0.0}
    return np.square([stddevs.get(one, assumed.single) for one in _numbers(quality)])


def _numbers(quality: FloatArray) -> list[int]:
    numbers: list[int] = np.nan_to_num(quality, nan=0.0).astype(int).tolist()
    return numbers
