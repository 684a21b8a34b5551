"""`python -m robotctl.replay.check_worker`: checks the recordings whose paths come on stdin.

A line of JSON each: a path in, then {"progress"} and at its end {"report"} out. The end of stdin
ends it: it never outlives who asked.
"""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path
from typing import Any

from robotctl.replay.check import check

PROGRESS_PERIOD_S = 0.1


def main() -> None:
    """Check until stdin ends."""
    for line in sys.stdin:
        told = time.monotonic()

        def tell_progress(done: int, total: int) -> None:
            nonlocal told
            if time.monotonic() - told > PROGRESS_PERIOD_S:
                told = time.monotonic()
                _tell({"progress": done / total})

        _tell({"report": check(Path(json.loads(line)), tell_progress).as_object()})


def _tell(said: dict[str, Any]) -> None:
    os.write(sys.stdout.fileno(), f"{json.dumps(said)}\n".encode())


if __name__ == "__main__":
    main()
