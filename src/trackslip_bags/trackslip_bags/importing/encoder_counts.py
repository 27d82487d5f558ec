# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The angle of one count of the sprockets' encoders, from the positions of a log."""

from collections.abc import Sequence

from trackslip_bags.importing.samples import Samples
from trackslip_estimation.setup_check.counts import angle_of_count


def encoder_resolution(samples: Sequence[Samples]) -> float:
    """Rad; 0 without sprockets, of speeds, and of positions without counts."""
    positions = [one.values["position"] for one in samples if one.role == "sprockets"]
    return angle_of_count(positions[0]) if positions else 0.0
