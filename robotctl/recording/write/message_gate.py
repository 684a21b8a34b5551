"""Limits how many messages of a topic are recorded per second, or stops recording it."""

from __future__ import annotations

from math import inf

from robotctl.kernel.units import NS_PER_S
from robotctl.recording.disk.storage import Buffer
from robotctl.recording.write.recorder import Recorder


class MessageGate:
    """A sink that hands messages on to the recorder, or counts them as throttled.

    It keeps the first message of each interval. An interval begins where the last one ended, so
    that the rate is reached on average; after a pause, with the next message.
    """

    def __init__(self, recorder: Recorder, channel: int, most_hz: float = inf) -> None:
        """Keep `most_hz` messages a second at most; inf keeps all, 0 none."""
        self._recorder = recorder
        self._channel = channel
        self._interval_ns = round(NS_PER_S / most_hz) if most_hz else None
        self._due_ns = 0
        self.is_shut = False
        """Whether no message is kept."""

    def __call__(
        self, data: Buffer, log_ns: int, publish_ns: int, sequence: int, gid: bytes
    ) -> None:
        """Record a message, or count it as throttled. The arguments are those of Recorder.write."""
        if self.is_shut or not self._keeps(log_ns):
            self._recorder.leave_out(self._channel, log_ns, sequence, gid)
        else:
            self._recorder.write(self._channel, data, log_ns, publish_ns, sequence, gid)

    def _keeps(self, log_ns: int) -> bool:
        interval_ns, due_ns = self._interval_ns, self._due_ns
        if not interval_ns:
            return interval_ns == 0
        if due_ns - interval_ns <= log_ns < due_ns:  # before that, the clock was set back
            return False
        is_on_time = due_ns <= log_ns < due_ns + interval_ns
        self._due_ns = (due_ns if is_on_time else log_ns) + interval_ns
        return True
