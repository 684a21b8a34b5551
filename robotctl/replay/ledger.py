"""Whether a recording accounts for every message that was received."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

Counts = Mapping[str, int]


def unbalanced(ledger: Mapping[str, Counts], *, finished: bool) -> Iterator[str]:
    """What does not add up in the ledger of a file, a sentence each.

    received = written + dropped at the end of a recording that was `finished`; at the end of an
    earlier file messages may be queued for the next.
    """
    for topic, counts in ledger.items():
        received, written, dropped = (counts.get(n, 0) for n in ("received", "written", "dropped"))
        accounted = written + dropped
        if received < accounted or (finished and received != accounted):
            yield (
                f"{topic}: {received} messages received, but {written} written "
                f"and {dropped} dropped"
            )
