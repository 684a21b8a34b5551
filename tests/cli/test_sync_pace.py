"""The wait before a piece is sent, which a library may have in a thread of its own."""

from __future__ import annotations

import threading

from robotctl.cli.support.sync_pace import SyncPace
from robotctl.errors import Interrupted


def test_the_end_of_a_run_ends_the_wait_of_another_thread() -> None:
    interrupted = threading.Event()

    def send(pace: SyncPace) -> None:
        try:
            pace(1_000_000_000)  # waits for days
        except Interrupted:
            interrupted.set()

    with SyncPace(0.01, None) as pace:
        threading.Thread(target=send, args=(pace,), daemon=True).start()
    assert interrupted.wait(30)
