# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Machines of a bag, by namespace; one machine's part: the topics of its namespace, named without it."""

from collections.abc import Collection, Iterable, Iterator

from trackslip_bags.sources import BagMessage, Source, TopicInfo, merge_topics

_GLOBAL_TOPICS = ("/tf", "/tf_static", "/diagnostics", "/clock")  # topics outside of namespaces
_MACHINE_TOPICS = ("sprockets", "vehicle", "slip_estimator/parameters")


def machine_namespaces(topics: Iterable[str]) -> list[str]:
    """Namespaces of the machines with these topics, '' for none: by sprockets, vehicle or parameters."""
    absolute = [topic if "/" in topic else f"/{topic}" for topic in topics]
    ends = [f"/{name}" for name in _MACHINE_TOPICS]
    within = {topic.removesuffix(end) for topic in absolute for end in ends if topic.endswith(end)}
    return sorted({name.strip("/") for name in within if not name or name.startswith("/")})


class NamespaceView:
    """A part of a bag: ``/digger1/sprockets`` is ``/sprockets``; topics of other machines are absent.

    ``/digger1/tf`` and the shared ``/tf`` are one topic.
    """

    def __init__(self, source: Source, namespace: str) -> None:
        self.start_ns, self.end_ns = source.start_ns, source.end_ns
        self._source, self._topics = source, source.topics()
        prefix = f"/{namespace.strip('/')}/"
        self._names = {  # by topic of the bag
            topic: f"/{topic.removeprefix(prefix)}" if topic.startswith(prefix) else topic
            for topic in self._topics
            if topic.startswith(prefix) or topic in _GLOBAL_TOPICS
        }

    def topics(self) -> dict[str, TopicInfo]:
        """Name within the namespace → information on the topic."""
        return merge_topics({name: self._topics[topic]} for topic, name in self._names.items())

    def messages(self, names: Collection[str] | None, start_ns: int, stop_ns: int) -> Iterator[BagMessage]:
        """The messages of the namespace, as those of ``Source.messages``."""
        renamed = {topic: name for topic, name in self._names.items() if names is None or name in names}
        for message in self._source.messages(renamed.keys(), start_ns, stop_ns):
            yield message._replace(topic=renamed[message.topic])

    def close(self) -> None:
        """Close the part."""
        self._source.close()
