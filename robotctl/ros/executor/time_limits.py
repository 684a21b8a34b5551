"""How long is long: the time limits of an executor, in ns, and why."""

from __future__ import annotations

NS_PER_S = 1_000_000_000

SLOW_CALLBACK_NS = 50_000_000
"""A callback that holds the loop for longer is warned about: it delays the control tick."""

SLOW_WARNING_PAUSE_NS = 10_000_000_000
"""The same callback is not warned about again for so long: the log is for people."""

SLICE_NS = 300_000
"""How long one entity may go on taking before the others get their turn."""

TURN_NS = 1_000_000
"""What all flooded entities share in one turn of the loop: it bounds the wait of the others."""

SHORTEST_SLICE_NS = 50_000
"""Where very many are flooded: below this, changing turns would cost more than the work."""

FLOOD_REST_S = 0.002
"""How long a flooded subscription collects."""

FLOODED_SHARE = 0.1
"""A pool that spends more of its time on taking messages is flooded. At 5 to 10 us for a message
that is 10 to 20 kHz."""

FASTEST_TOPIC_HZ = 50_000.0
"""No process of ours receives more: a queue must hold what comes during a rest."""

LOOKS_PER_VERDICT = 32
"""After so many looks at a subscription its rate is judged anew."""

FLOODED_VERDICT_NS = 16_000_000
"""So many looks in less (over 2 kHz): it is flooded, and collects."""

CALM_VERDICT_NS = 64_000_000
"""So many looks in more (under 500 Hz): it is flooded no more."""
