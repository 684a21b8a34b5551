"""The measured process: one way to receive a topic that another process publishes.

    bare      the daemon's tap (raw subscriptions) with a sink that only counts
    plain     the tap with a sink that writes the data to a file
    none      the recorder as the daemon runs it, without compression
    zstd      the same with the default compression
    classic   rclpy's SingleThreadedExecutor with the mcap package's writer

Prints the result as a line of JSON, and ends when its stdin is closed.
"""

from __future__ import annotations

import asyncio
import gc
import json
import math
import os
import resource
import sys
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import (
    AbstractContextManager,
    ExitStack,
    asynccontextmanager,
    contextmanager,
    suppress,
)
from dataclasses import asdict, dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

from robotctl.base import environment

START_TIMEOUT_S = 60.0
WARM_UP_S = 1.0
TICK_HZ = 1000.0


@dataclass(frozen=True)
class Measured:
    """The result of one process: CPU per message [us], counts, and the p99.9 `lag_ms` of the loop.

    `lag_ms` is 0 without ticks.
    """

    cpu_us: float
    per_second: float
    lost: int
    dropped: int
    lag_ms: float
    resident_mb: float


class Taker(Protocol):
    """The counts of what receives the messages."""

    @property
    def received(self) -> int: ...

    @property
    def lost(self) -> int:
        """How many messages are missing between those that were received."""

    @property
    def dropped(self) -> int: ...


Sinks = tuple[Taker, Callable[[Any], Any]]
"""The counts, and the function that opens the sink of a topic."""


class Counter:
    """A sink that counts messages, and the sequence numbers that are missing between them."""

    def __init__(self, keep: Callable[[bytes], object] = lambda data: None) -> None:
        self.received = 0
        self.dropped = 0
        self._keep = keep
        self._first: int | None = None
        self._last = 0

    @property
    def lost(self) -> int:
        return 0 if self._first is None else self._last - self._first + 1 - self.received

    def __call__(self, data: bytes, _log: int, _publish: int, sequence: int, _gid: bytes) -> None:
        if self._first is None:
            self._first = sequence
        self._last = sequence
        self.received += 1
        self._keep(data)


class Recording:
    """The recorder's own counts."""

    def __init__(self, recorder: Any) -> None:
        self._recorder = recorder

    @property
    def received(self) -> int:
        return int(self._recorder.stats().received)

    @property
    def lost(self) -> int:
        return int(self._recorder.stats().lost)

    @property
    def dropped(self) -> int:
        return int(self._recorder.stats().dropped)


@contextmanager
def bare(folder: Path) -> Iterator[Sinks]:
    counter = Counter()
    yield counter, lambda topic: counter


@contextmanager
def plain(folder: Path) -> Iterator[Sinks]:
    with (folder / "plain").open("wb") as file:
        counter = Counter(file.write)
        yield counter, lambda topic: counter


@contextmanager
def recording(compressed: bool, folder: Path) -> Iterator[Sinks]:
    from robotctl.recording import Compression, Recorder, RecorderOptions, Topic

    compression = Compression.ZSTD if compressed else Compression.NONE
    options = RecorderOptions(compression=compression)
    recorder = Recorder(folder / "recording", options, on_failure=sys.exit)

    def open_sink(topic: Any) -> Any:
        return partial(recorder.write, recorder.add_topic(Topic(**asdict(topic))))

    yield Recording(recorder), open_sink
    stats = recorder.close()
    assert stats.received == stats.written + stats.dropped, stats


TAPPED: dict[str, Callable[[Path], AbstractContextManager[Sinks]]] = {
    "bare": bare,
    "plain": plain,
    "none": partial(recording, False),
    "zstd": partial(recording, True),
}


@asynccontextmanager
async def tapped(contender: str, topic: str, folder: Path) -> AsyncIterator[Taker]:
    """Receive every topic of the domain as the daemon does, into the contender's sink."""
    from robotctl.ros.session import ros_session
    from robotctl.ros.tap.tap import Tap

    with ExitStack() as at_end, TAPPED[contender](folder) as (taker, open_sink):
        async with ros_session(domain_id=domain_id(), namespace="", at_end=at_end) as session:
            running = asyncio.create_task(Tap(session, open_sink).run())
            yield taker
            running.cancel()
            with suppress(asyncio.CancelledError):
                await running


@asynccontextmanager
async def classic(topic: str, folder: Path) -> AsyncIterator[Taker]:
    """Receive in the usual Python way: SingleThreadedExecutor in a thread, mcap's writer."""
    import rclpy
    from mcap.writer import CompressionType, Writer
    from rclpy.executors import SingleThreadedExecutor

    from robotctl.ros.qos import RECORDING_DEPTH

    rclpy.init(args=[], domain_id=domain_id())
    node = rclpy.create_node("recorder")
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while not (publishers := node.get_publishers_info_by_topic(topic)):  # noqa: ASYNC110
        await asyncio.sleep(0.01)
    type_name = publishers[0].topic_type
    stop = threading.Event()
    with (folder / "classic.mcap").open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start(profile="ros2")
        channel = writer.register_channel(
            topic, "cdr", writer.register_schema(type_name, "ros2msg", b"")
        )
        counter = Counter()

        def take(data: bytes, info: dict[str, int]) -> None:
            sequence = info["publication_sequence_number"]
            log_ns, publish_ns = info["received_timestamp"], info["source_timestamp"]
            counter(data, log_ns, publish_ns, sequence, b"")
            writer.add_message(channel, log_ns, data, publish_ns, sequence)

        def spin() -> None:
            while not stop.is_set():
                executor.spin_once(timeout_sec=0.1)

        package, kind, name = type_name.split("/")
        message_class = getattr(import_module(f"{package}.{kind}"), name)
        # rclpy's own types know a callback of one argument only.
        callback: Any = take
        node.create_subscription(message_class, topic, callback, RECORDING_DEPTH, raw=True)
        thread = threading.Thread(target=spin)
        thread.start()
        yield counter
        stop.set()
        thread.join()
        writer.finish()
    rclpy.shutdown()


def domain_id() -> int:
    """Return the ROS domain of this benchmark alone: the tap receives every topic in it."""
    return int(os.environ["ROS_DOMAIN_ID"])


def cpu_s() -> float:
    """Return the CPU time of all threads of this process [s]."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def resident_mb(pid: int | str = "self") -> float:
    """Return the resident memory of a process [MB]."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


async def lateness_ms(seconds: float) -> list[float]:
    """Return how late each tick of 1 kHz comes through the loop [ms]."""
    from robotctl.ros import Ticker

    late: list[float] = []
    async with Ticker(TICK_HZ) as ticker:
        while len(late) < seconds * TICK_HZ:
            tick = await anext(ticker)
            late += [(tick.t_ns - tick.due_ns) / 1e6] * (1 + tick.missed)
    return late


def p999(values: list[float]) -> float:
    return sorted(values)[math.ceil(0.999 * len(values)) - 1]


async def measure(contender: str, topic: str, seconds: float, ticks: bool, folder: Path) -> None:
    """Receive `topic` in the contender's way, and print the `Measured` as JSON."""
    way = classic(topic, folder) if contender == "classic" else tapped(contender, topic, folder)
    async with way as taker:
        async with asyncio.timeout(START_TIMEOUT_S):
            while not taker.received:  # noqa: ASYNC110 - the load is elsewhere
                await asyncio.sleep(0.05)
        gc.collect()
        gc.freeze()  # as the daemon does
        await asyncio.sleep(WARM_UP_S)
        begun, cpu = time.monotonic(), cpu_s()
        received, lost, dropped = taker.received, taker.lost, taker.dropped
        late = await lateness_ms(seconds) if ticks else [0.0]
        if not ticks:
            await asyncio.sleep(seconds)
        took_s, cpu = time.monotonic() - begun, cpu_s() - cpu
        received = taker.received - received
        measured = Measured(
            cpu_us=1e6 * cpu / received if received else math.inf,
            per_second=received / took_s,
            lost=taker.lost - lost,
            dropped=taker.dropped - dropped,
            lag_ms=p999(late),
            resident_mb=resident_mb(),
        )
        print(json.dumps(asdict(measured)), flush=True)
        await asyncio.to_thread(sys.stdin.read)


def main() -> None:
    """Run with the arguments CONTENDER, TOPIC, SECONDS, TICKS (0 or 1), FOLDER."""
    contender, topic, seconds, ticks, folder = sys.argv[1:]
    if contender in TAPPED:
        environment.prepare()  # as the daemon does
    asyncio.run(measure(contender, topic, float(seconds), ticks == "1", Path(folder)))


if __name__ == "__main__":
    main()
