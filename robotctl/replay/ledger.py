"""Whether a recording accounts for every message that was received."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping

COUNTS = ("received", "written", "dropped")


def unbalanced(ledger: Mapping[str, str], *, finished: bool) -> Iterator[str]:
    """What does not add up in the ledger of a file, a sentence each.

    received = written + dropped in the last file of a recording that was `finished`; at the end
    of an earlier one messages may be queued for the next.
    """
    for topic, text in ledger.items():
        try:
            account = json.loads(text)
            received, written, dropped = (int(account[name]) for name in COUNTS)
        except (ValueError, TypeError, KeyError, RecursionError):
            yield f"the ledger of {topic} cannot be read"
            continue
        accounted = written + dropped
        if received < accounted or (finished and received != accounted):
            yield (
                f"{topic}: {received} messages received, but {written} written "
                f"and {dropped} dropped"
            )
