# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Publishers of messages that are sent often and differ in their numbers alone."""

from typing import Any

from rclpy.serialization import serialize_message

from trackslip_common.message_buffer import MessageBuffer
from trackslip_common.nodes.messages import fields_of, type_name_of


class PackedOutput:
    """Publishes its ``message``, which the caller fills, as bytes.

    Args:
        publisher: for messages of the type of ``blank``.
        blank: a message with the strings and lengths of lists of all messages.
    """

    def __init__(self, publisher: Any, blank: Any) -> None:
        self._publisher = publisher
        self._buffer = MessageBuffer(type_name_of(type(blank)), fields_of, serialize_message(blank))
        self.message = self._buffer.message

    def publish(self) -> None:
        """Send the message in its present state."""
        self._publisher.publish(bytes(self._buffer))
