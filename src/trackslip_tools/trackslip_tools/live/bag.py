# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Feeds the live page from a bag, at a multiple of real time."""

from functools import partial
from typing import Any

from trackslip_bags.input_filters import InputFilters, relative_name
from trackslip_bags.parameters import bag_parameters
from trackslip_bags.playback import Playback, PlayedMessage, played_messages
from trackslip_bags.reader import Bag, absolute_name
from trackslip_estimation.slip.measurements import POSE_SET, SET_POSE
from trackslip_tools.live import inputs
from trackslip_tools.live.encoding import local_clock_ms
from trackslip_tools.live.fixes import timeouts_of
from trackslip_tools.live.state import LiveState

_END_REASON = "end of the bag"
_COMMAND_TOPICS = (SET_POSE, POSE_SET)  # poses that are commands, not measurements


def page_topics(bag: Bag) -> dict[str, str]:
    """Published topic → type, of the topics of the page that the bag has with that type, and of all poses."""
    return {
        absolute_name(topic): info.type_name
        for topic, info in bag.topics.items()
        if inputs.TYPES.get(relative_name(topic), inputs.POSE_TYPE) == info.type_name
        and relative_name(topic) not in _COMMAND_TOPICS
    }


class BagFeed:
    """Feeds the messages of a bag to the state; time is that of the bag.

    Raises:
        InputError: the topic of the estimator's parameters holds something else.
    """

    def __init__(self, bag: Bag, state: LiveState, rate: float, filters: InputFilters) -> None:
        self._bag, self._state = bag, state
        self._topics = page_topics(bag)
        timeouts = timeouts_of(bag_parameters(bag))  # valid even after a start behind their message
        state.set_timeouts({relative_name(source): timeout for source, timeout in timeouts.items()})
        self._playback = Playback(partial(played_messages, bag, filters, self._topics), rate)
        self._is_over = False  # whether the last moment was shown

    @property
    def is_finished(self) -> bool:
        """Whether all messages were played."""
        return self._playback.is_finished

    def advance(self, wall_s: float) -> dict[str, Any]:
        """Play until now, and return the frame; after the end, the last values stay."""
        if self._is_over:
            return self._state.final_frame(_END_REASON)
        newest: dict[str, PlayedMessage] = {}
        for message in self._playback.due_messages(wall_s):
            name = relative_name(message.topic)
            if name in inputs.EVERY_MESSAGE:
                self._process(message)
            else:
                newest[message.topic] = message
        for message in newest.values():
            self._process(message)
        self._is_over = self.is_finished
        return self._state.next_frame(self._now_s, local_clock_ms(self._playback.bag_ns))

    @property
    def _now_s(self) -> float:
        return (self._playback.bag_ns - self._bag.start_ns) * 1e-9

    def _process(self, message: PlayedMessage) -> None:
        content = self._bag.deserialize(message.raw, self._topics[message.topic])
        self._state.process(
            relative_name(message.topic), content, (message.log_time_ns - self._bag.start_ns) * 1e-9
        )
