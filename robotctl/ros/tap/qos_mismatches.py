"""Subscriptions that hear nothing of a publisher, because their QoS does not match."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from itertools import islice, product
from typing import Final

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from robotctl.printable import printable
from robotctl.ros.graph import endpoints
from robotctl.ros.graph.endpoints import Endpoint

_log = logging.getLogger(__name__)

MAX_ENDPOINTS: Final = 20
"""Limit on the publishers and on the subscriptions of a topic that are compared."""

MAX_NAMED: Final = 20
MAX_LOGGED: Final = 1_000


class QosMismatches:
    """The mismatches on topics that `look` is called for; one is named for each topic.

    Hidden nodes are left out: a recorder may ask for latched messages of some publishers only.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._counts: dict[str, tuple[int, int]] = {}
        self._sentences: dict[str, str] = {}
        self._logged = 0

    def look(self, topic: str, publishers: int) -> None:
        """Compare the profiles if publishers or subscriptions came or went."""
        counts = publishers, endpoints.subscription_count(self._node, topic)
        if counts == self._counts.get(topic):
            return
        self._counts[topic] = counts
        sentence = mismatch(
            topic,
            endpoints.publishers(self._node, topic),
            endpoints.subscriptions(self._node, topic),
        )
        if sentence and sentence != self._sentences.get(topic) and self._logged < MAX_LOGGED:
            self._logged += 1
            _log.warning("%s", sentence)
        if sentence:
            self._sentences[topic] = sentence
        else:
            self._sentences.pop(topic, None)

    def forget(self, topic: str) -> None:
        """Forget a topic that is not recorded any more."""
        self._counts.pop(topic, None)
        self._sentences.pop(topic, None)

    def warnings(self) -> Iterator[str]:
        """Yield a sentence for each topic with a mismatch, up to MAX_NAMED."""
        yield from islice(self._sentences.values(), MAX_NAMED)
        if len(self._sentences) > MAX_NAMED:
            yield f"{len(self._sentences) - MAX_NAMED} more topics have a QoS mismatch"


def mismatch(topic: str, publishers: Sequence[Endpoint], subscriptions: Sequence[Endpoint]) -> str:
    """Return a sentence about the first pair that does not match, "" if all do."""
    offers, requests = (
        [each for each in side if not each.node_name.startswith("_")][:MAX_ENDPOINTS]
        for side in (publishers, subscriptions)
    )
    for offer, request in product(offers, requests):
        if reason := _reason(offer.qos_profile, request.qos_profile):
            return (
                f"{_name(request)} hears nothing of {_name(offer)} on {printable(topic)}: {reason}"
            )
    return ""


def _reason(offered: QoSProfile, asked: QoSProfile) -> str:
    if (offered.reliability, asked.reliability) == (
        ReliabilityPolicy.BEST_EFFORT,
        ReliabilityPolicy.RELIABLE,
    ):
        return "reliability best_effort is offered, reliable asked for"
    if (offered.durability, asked.durability) == (
        DurabilityPolicy.VOLATILE,
        DurabilityPolicy.TRANSIENT_LOCAL,
    ):
        return "durability volatile is offered, transient_local asked for"
    return ""


def _name(endpoint: Endpoint) -> str:
    return printable(f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}")
