# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What the live estimator of a bag had learned before, which a replay starts from too."""

from trackslip_bags.parameters import bag_learned
from trackslip_bags.reader import Bag
from trackslip_common.errors import InputError
from trackslip_estimation.slip.learned import Learned, from_tree, meaning
from trackslip_estimation.slip.parameters import SlipEstimatorParameters


def learned_before(bag: Bag, p: SlipEstimatorParameters) -> tuple[Learned | None, str]:
    """It, or None where the bag has nothing of the kind for these parameters; a line for the user.

    Raises:
        InputError: the topic of the parameters holds something else.
    """
    tree = bag_learned(bag)
    if tree is None:
        return None, ""
    try:
        return from_tree(tree, meaning(p)), "starts from what was learned before the bag begins"
    except InputError as error:
        return None, f"what was learned before the bag begins is not used: {error}"
