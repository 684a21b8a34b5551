"""The time limits of an executor, and why they are so."""

from __future__ import annotations

NS_PER_S = 1_000_000_000

SLOW_CALLBACK_NS = 50_000_000
"""A callback that holds the loop longer is warned about: it delays the control tick."""

SLOW_WARNING_PAUSE_NS = 10_000_000_000
"""The least time between two warnings about the same callback, so that the log stays readable."""

SLICE_NS = 300_000
"""How long one entity may take messages before the others get their turn."""

TURN_NS = 1_000_000
"""The time that all flooded entities share in one turn of the loop; it limits how long the others
wait."""

SHORTEST_SLICE_NS = 50_000
"""The shortest slice of a flooded entity: with a shorter one, changing between entities would cost
more than the work."""

FLOOD_REST_S = 0.002
"""How long the messages of a flooded subscription are collected."""

FLOODED_SHARE = 0.1
"""A pool that spends a larger share of its time on taking messages is flooded. At 5 to 10 us for a
message, that is at 10 to 20 kHz."""

FASTEST_TOPIC_HZ = 50_000.0
"""No process of ours receives more: a queue must hold the messages of one rest at this rate."""

POLLS_PER_RATE_CHECK = 32
"""The rate of a subscription is computed each time it was polled this often."""

FLOODED_WITHIN_NS = 16_000_000
"""The subscription is flooded if POLLS_PER_RATE_CHECK polls took less time (over 2 kHz)."""

CALM_BEYOND_NS = 64_000_000
"""It is no longer flooded if POLLS_PER_RATE_CHECK polls took more time (under 500 Hz)."""
