# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""From a bag to what the tuner scores."""

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.reader import Bag
from trackslip_common.errors import InputError
from trackslip_common.topics import TRUE_ODOMETRY
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_tools.replay.run import own_reference
from trackslip_tools.replay.scoring import path_of_series
from trackslip_tools.replay.settled import read_settled
from trackslip_tools.tuning.task import Task, make_task


def read_task(
    bag: Bag,
    p: SlipEstimatorParameters,
    filters: InputFilters,
    reference: str | None,
    *,
    needs_reference: bool,
) -> Task:
    """A bag's measurements and its reference, where it has one.

    What was asked of the estimator while it ran, but for its pose, is left out.

    Raises:
        InputError: the bag lacks what is needed.
    """
    reference = reference or own_reference(bag)
    wanted = (reference,) if reference else ()
    measurements, found = read_settled(bag, p, filters, wanted, frozenset(wanted) - {TRUE_ODOMETRY})
    series = found.get(reference or "")
    if series is None and needs_reference:
        raise InputError(f"bag '{bag.path}': no reference for this objective; --reference TOPIC names one")
    return make_task(str(bag.path), measurements, p, None if series is None else path_of_series(series))
