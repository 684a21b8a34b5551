"""A terminal that answers, as those of people do, until it falls silent."""

from __future__ import annotations

import os
import queue
import select
import threading
from collections.abc import Mapping
from contextlib import suppress

from tests.support.terminals import CODE, Terminal

TELLS_RELEASES, IDENTIFY = b"\x1b[?u", b"\x1b[c"
ANSWERS = {TELLS_RELEASES: b"\x1b[?11u", IDENTIFY: b"\x1b[?62c"}


class AnsweringTerminal(Terminal):
    """A command line on a terminal that answers questions while `is_silent` is false.

    With `tells_releases` it knows the kitty keyboard protocol; the test sends the keys.
    """

    def __init__(
        self,
        *arguments: object,
        tells_releases: bool,
        program: tuple[str, ...] = (CODE,),
        environment: Mapping[str, str] = os.environ,
    ) -> None:
        super().__init__(*arguments, program=program, environment=environment)
        self.is_silent = False
        self._known = {TELLS_RELEASES, IDENTIFY} if tells_releases else {IDENTIFY}
        self._drawn: queue.Queue[bytes] = queue.Queue()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._answer)
        self._thread.start()

    def hang_up(self) -> None:
        self._end_thread()
        super().hang_up()

    def close(self) -> None:
        self._end_thread()
        super().close()

    def _end_thread(self) -> None:
        self._ended.set()
        self._thread.join()

    def _read(self, seconds: float) -> bool:
        try:
            self.seen += self._drawn.get(timeout=seconds).decode(errors="replace")
        except queue.Empty:
            return False
        return True

    def _answer(self) -> None:
        rest = b""
        with suppress(OSError):  # the process has ended
            while not self._ended.is_set():
                if not select.select([self._file], [], [], 0.02)[0]:
                    continue
                data = os.read(self._file, 65536)
                self._drawn.put(data)
                rest += data
                for question in sorted(self._known):
                    if not self.is_silent:
                        os.write(self._file, ANSWERS[question] * rest.count(question))
                begun = rest[rest.rfind(b"\x1b") :]
                rest = begun if any(q.startswith(begun) and q != begun for q in ANSWERS) else b""
