# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The live page over a bag: its messages as they came, at so many times real time."""

from functools import partial
from typing import Any

from trackslip_bags.input_filters import InputFilters, relative
from trackslip_bags.parameters import bag_parameters
from trackslip_bags.playback import Playback, Played, played
from trackslip_bags.reader import Bag, absolute
from trackslip_estimation.slip.measurements import POSE_SET, SET_POSE
from trackslip_tools.live import inputs
from trackslip_tools.live.encoding import shown_ms
from trackslip_tools.live.fixes import timeouts_of
from trackslip_tools.live.state import LiveState

_END = "end of the bag"
_COMMANDS = (SET_POSE, POSE_SET)  # poses that nobody measured


def shown_topics(bag: Bag) -> dict[str, str]:
    """Topic as published → type, of what the page looks at and the bag has in that type, and of all poses."""
    return {
        absolute(topic): info.type_name
        for topic, info in bag.topics.items()
        if inputs.TYPES.get(relative(topic), inputs.POSE_TYPE) == info.type_name
        and relative(topic) not in _COMMANDS
    }


class BagFeed:
    """Gives the state what the bag holds; time is that of the bag.

    Raises:
        InputError: what the bag holds on the estimator's topic are no parameters.
    """

    def __init__(self, bag: Bag, state: LiveState, rate: float, filters: InputFilters) -> None:
        self._bag, self._state = bag, state
        self._topics = shown_topics(bag)
        timeouts = timeouts_of(bag_parameters(bag))  # also where it starts after they were published
        state.expect({relative(source): timeout for source, timeout in timeouts.items()})
        self._playback = Playback(partial(played, bag, filters, self._topics), rate)
        self._is_over = False  # and the last moment was shown

    @property
    def finished(self) -> bool:
        """Whether all was shown."""
        return self._playback.finished

    def advance(self, wall_s: float) -> dict[str, Any]:
        """Play until now; the frame. After the end the time stands still, and all values stay."""
        if self._is_over:
            return self._state.hold(_END)
        newest: dict[str, Played] = {}
        for message in self._playback.due(wall_s):
            name = relative(message.topic)
            if name in inputs.EVERY_MESSAGE:
                self._process(message)
            else:
                newest[message.topic] = message
        for message in newest.values():
            self._process(message)
        self._is_over = self.finished
        return self._state.tick(self._now_s, shown_ms(self._playback.bag_ns))

    @property
    def _now_s(self) -> float:
        return (self._playback.bag_ns - self._bag.start_ns) * 1e-9

    def _process(self, message: Played) -> None:
        found = self._bag.deserialize(message.raw, self._topics[message.topic])
        self._state.process(relative(message.topic), found, (message.log_time_ns - self._bag.start_ns) * 1e-9)
