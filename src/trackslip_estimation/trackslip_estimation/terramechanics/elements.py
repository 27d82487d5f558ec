# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Elements of the contact of a track with the ground."""

import numpy as np

from trackslip_common.arrays import FloatArray


def element_positions(length: float, elements: int) -> FloatArray:
    """Return x_e of the centres of the elements of a contact (n,), foremost first, m."""
    return length * (0.5 - (np.arange(elements) + 0.5) / elements)
