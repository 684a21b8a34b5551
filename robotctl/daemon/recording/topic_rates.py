"""Message rates from the recorder's counts, and topics with a high data rate."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

from robotctl.kernel.units import NS_PER_S

HEAVY_BYTES_PER_S = 5e6
HEAVY_WINDOW_S = 5.0
"""A topic is heavy above this data rate, averaged over this time..."""

CALM_SHARE = 0.5
"""...until its data rate falls below this share of the limit."""

TopicKey = tuple[str, str]
"""Name and type."""


class RateMeter:
    """Rates [1/s] to two digits, from counts, over the time between the last two samples."""

    def __init__(self) -> None:
        self._counts: Mapping[TopicKey, int] = {}
        self.rates: Mapping[TopicKey, float] = {}
        """The latest rates; another object after each sample."""

        self._t_ns = 0

    def sample(self, t_ns: int, counts: Mapping[TopicKey, int]) -> None:
        """Add the counts at steady time `t_ns`."""
        hundredths = 100 * NS_PER_S / (t_ns - self._t_ns)
        self.rates = {
            topic: round((count - self._counts.get(topic, 0)) * hundredths) / 100
            for topic, count in counts.items()
        }
        self._counts, self._t_ns = counts, t_ns


class HeavyTopics:
    """The topics with a data rate above HEAVY_BYTES_PER_S, and their rates [bytes/s]."""

    def __init__(self) -> None:
        self._samples: deque[tuple[int, Mapping[TopicKey, int]]] = deque()
        self.rates: Mapping[TopicKey, float] = {}
        """Data rates of the heavy topics over the last HEAVY_WINDOW_S."""

    def sample(self, t_ns: int, sizes: Mapping[TopicKey, int]) -> None:
        """Add the bytes received so far, at steady time `t_ns`."""
        samples = self._samples
        samples.append((t_ns, sizes))
        while len(samples) > 2 and t_ns - samples[1][0] >= HEAVY_WINDOW_S * NS_PER_S:
            samples.popleft()
        first_ns, before = samples[0]
        elapsed_s = (t_ns - first_ns) / NS_PER_S
        if elapsed_s < HEAVY_WINDOW_S:
            return
        rates = {topic: (size - before.get(topic, 0)) / elapsed_s for topic, size in sizes.items()}
        self.rates = {
            topic: rate
            for topic, rate in rates.items()
            if rate > HEAVY_BYTES_PER_S * (CALM_SHARE if topic in self.rates else 1.0)
        }
