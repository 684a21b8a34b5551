"""AsyncioExecutor against rclpy's executors: CPU per message, idle CPU, loss and latency.

    python benchmarks/executor.py                                   everything, about 12 minutes
    python benchmarks/executor.py --figures typed,idle --rounds 5 --seconds 3
    python benchmarks/executor.py --figures typed --only asyncio    one alone, for a profiler

Every measurement is a fresh process (the subject) with one executor, eight idle subscriptions and
the services of its node; a second process publishes or calls. Each round measures every contender,
so that a noisy machine is noisy for all; ratios are computed within a round. Shown are medians over
the rounds, and the lowest and highest in brackets. CPU is that of the whole subject process,
including the threads of the middleware.

The round trip of a service is measured twice. With a pause between the calls every thread on the
way sleeps and every cache is cold: the result is then mostly how long the machine takes to wake up,
also in the client's process, and that is the same for every executor.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import resource
import statistics
import struct
import subprocess
import sys
import threading
import time
from collections.abc import AsyncIterator, Iterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Any

DEPTH = 10_000
WARM_UP_S = 0.5
START_TIMEOUT_S = 30.0

ASYNCIO, TAP, SINGLE, EVENTS, POLLING = "asyncio", "tap", "single", "events", "polling"
TICKER, SLEEP = "ticker", "sleep"
EXECUTORS = (ASYNCIO, SINGLE, EVENTS, POLLING)
OURS = (ASYNCIO, TAP, TICKER, SLEEP)
"""These contenders run in `robotctl.ros.executor.run`, the others in `asyncio.run`."""


@dataclass(frozen=True)
class Target:
    """The limit of a contender's value or, with `against`, of its ratio to that contender's."""

    contender: str
    limit: float
    against: str = ""


@dataclass(frozen=True)
class Figure:
    """One figure: its title and value, its contenders, their load, and its targets."""

    title: str
    value: str
    unit: str
    contenders: tuple[str, ...]
    hz: float = 0.0
    raw: bool = False
    pause_s: float | None = None
    """The pause between two calls of the subject's service; None: no calls."""
    targets: tuple[Target, ...] = ()
    shortest_s: float = 0.0


FIGURES = {
    "typed": Figure(
        "CPU per message under flood (10 kHz), typed",
        "cpu_us_per_message",
        "us",
        EXECUTORS,
        hz=10_000.0,
        targets=(Target(ASYNCIO, 1 / 15, SINGLE), Target(ASYNCIO, 1 / 1.7, EVENTS)),
    ),
    "raw": Figure(
        "CPU per message under flood (10 kHz), raw",
        "cpu_us_per_message",
        "us",
        (ASYNCIO, TAP, SINGLE, EVENTS, POLLING),
        hz=10_000.0,
        raw=True,
        targets=(
            Target(ASYNCIO, 1 / 25, SINGLE),
            Target(ASYNCIO, 1 / 1.2, EVENTS),
            Target(TAP, 1 / 25, SINGLE),
            Target(TAP, 1 / 1.2, EVENTS),
        ),
    ),
    "kilohertz": Figure(
        "CPU at 1 kHz",
        "cpu_percent",
        "%",
        EXECUTORS,
        hz=1000.0,
        targets=(Target(ASYNCIO, 1 / 4, SINGLE), Target(ASYNCIO, 0.8, EVENTS)),
    ),
    "lost-typed": Figure(
        "lost of 10 kHz typed for 10 s, depth 10k",
        "lost",
        "",
        (ASYNCIO,),
        hz=10_000.0,
        targets=(Target(ASYNCIO, 0),),
        shortest_s=10.0,
    ),
    "lost-raw": Figure(
        "lost of 30 kHz raw",
        "lost",
        "",
        (TAP,),
        hz=30_000.0,
        raw=True,
        targets=(Target(TAP, 0),),
    ),
    "idle": Figure("idle CPU", "cpu_percent", "%", EXECUTORS, targets=(Target(ASYNCIO, 0.3),)),
    "service": Figure(
        "service round trip, one call after the other, p50",
        "p50_us",
        "us",
        EXECUTORS,
        pause_s=0.0,
        targets=(Target(ASYNCIO, 0.6, SINGLE),),
    ),
    "service-rare": Figure(
        "service round trip, 5 ms between the calls, p50",
        "p50_us",
        "us",
        EXECUTORS,
        pause_s=0.005,
        targets=(Target(ASYNCIO, 0.6, SINGLE),),
    ),
    "tick": Figure(
        "lateness of a 1 kHz tick under 1 kHz traffic, p50",
        "p50_us",
        "us",
        (TICKER, SLEEP),
        hz=1000.0,
        targets=(Target(TICKER, 1 / 5, SLEEP),),
    ),
}


# The subject: one process, one executor.


class Received:
    """Counts messages, and the numbers that are missing between them."""

    def __init__(self) -> None:
        self.count = 0
        self.lost = 0
        self._next: int | None = None

    def number(self, number: int) -> None:
        if self._next is not None:
            self.lost += number - self._next
        self._next = number + 1
        self.count += 1

    def typed(self, message: Any) -> None:
        self.number(int(message.linear.x))

    def raw(self, data: bytes) -> None:
        self.number(int(struct.unpack_from("<d", data, 4)[0]))

    def tapped(self, data: bytes, *_: object) -> None:
        self.number(int(struct.unpack_from("<d", data, 4)[0]))


@asynccontextmanager
async def executing(contender: str, node: Any) -> AsyncIterator[None]:
    """Run the node's callbacks in the contender's executor during the block."""
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.experimental.events_executor import EventsExecutor

    from robotctl.ros import AsyncioExecutor

    if contender in OURS:
        async with AsyncioExecutor() as executor:
            executor.add_node(node)
            yield
        return
    spinning: Any = EventsExecutor() if contender == EVENTS else SingleThreadedExecutor()
    spinning.add_node(node)
    stop = threading.Event()
    if contender == POLLING:

        async def poll() -> None:
            while True:
                spinning.spin_once(timeout_sec=0)
                await asyncio.sleep(0.001)

        task = asyncio.create_task(poll())
        yield
        task.cancel()
        return

    def spin() -> None:
        while not stop.is_set():
            # Finite: without a timeout this version of EventsExecutor waits busily.
            spinning.spin_once(timeout_sec=0.1)

    thread = threading.Thread(target=spin, daemon=True)
    thread.start()
    yield
    stop.set()
    thread.join(1.0)


def cpu_s() -> float:
    """Return the CPU time of all threads of this process [s]."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


async def subject(name: str, contender: str, seconds: float) -> dict[str, float]:
    """Measure one figure of one contender in this process; return the values by name."""
    import rclpy
    from geometry_msgs.msg import Twist
    from rclpy.signals import SignalHandlerOptions
    from std_srvs.srv import SetBool

    from robotctl.ros import RawTap

    figure = FIGURES[name]
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("subject")
    received = Received()
    for index in range(8):
        node.create_subscription(Twist, f"idle_{index}", received.typed, 10)
    node.create_service(SetBool, "served", lambda request, response: response)
    callback: Any = received.typed
    if figure.raw:
        callback = RawTap(received.tapped) if contender == TAP else received.raw
    node.create_subscription(Twist, "load", callback, DEPTH, raw=figure.raw)

    async with executing(contender, node):
        if figure.pause_s is not None:
            await asyncio.to_thread(sys.stdin.read)
            return {}
        async with asyncio.timeout(START_TIMEOUT_S):
            while figure.hz and not received.count:  # noqa: ASYNC110 - the load is elsewhere
                await asyncio.sleep(0.01)
        await asyncio.sleep(WARM_UP_S)
        begun, cpu, count, lost = time.monotonic(), cpu_s(), received.count, received.lost
        lateness = await tick(contender, seconds)
        passed = time.monotonic() - begun
        cpu, count, lost = cpu_s() - cpu, received.count - count, received.lost - lost
    return {
        "cpu_percent": 100 * cpu / passed,
        "cpu_us_per_message": 1e6 * cpu / count if count else 0.0,
        "messages_per_second": count / passed,
        "lost": lost,
        "p50_us": statistics.median(lateness) / 1000 if lateness else 0.0,
    }


async def tick(contender: str, seconds: float) -> list[int]:
    """Wait; a contender that ticks does so at 1 kHz. Return how late its ticks were [ns]."""
    from robotctl.ros import Ticker

    count = round(1000 * seconds)
    lateness: list[int] = []
    if contender == TICKER:
        async with Ticker(1000.0) as ticker:
            while len(lateness) < count:
                now = await anext(ticker)
                lateness.append(now.t_ns - now.due_ns)
    elif contender == SLEEP:
        due_ns = time.monotonic_ns()
        while len(lateness) < count:
            due_ns += 1_000_000
            await asyncio.sleep((due_ns - time.monotonic_ns()) / 1e9)
            lateness.append(time.monotonic_ns() - due_ns)
    else:
        await asyncio.sleep(seconds)
    return lateness


# The load: a process of its own.


def publish(hz: float, raw: bool) -> None:
    """Publish numbered Twists at a rate until stdin closes."""
    import rclpy
    from geometry_msgs.msg import Twist

    rclpy.init(args=[])
    node = rclpy.create_node("load")
    publisher = node.create_publisher(Twist, "load", DEPTH)
    stop = threading.Event()

    def wait_for_the_end() -> None:
        sys.stdin.read()
        stop.set()

    threading.Thread(target=wait_for_the_end, daemon=True).start()
    while not publisher.get_subscription_count() and not stop.is_set():
        time.sleep(0.01)
    message = Twist()
    sent = 0
    begun = time.monotonic()
    while not stop.is_set():
        due = (time.monotonic() - begun) * hz
        while sent < due:
            if raw:
                publisher.publish(b"\0\1\0\0" + struct.pack("<6d", sent, 0, 0, 0, 0, 0))
            else:
                message.linear.x = float(sent)
                publisher.publish(message)
            sent += 1
        time.sleep(0.0003)
    node.destroy_node()
    rclpy.shutdown()


def call(seconds: float, pause_s: float) -> dict[str, float]:
    """Call the subject's service without an executor, by polling; return the median [us]."""
    import rclpy
    from std_srvs.srv import SetBool

    rclpy.init(args=[])
    node = rclpy.create_node("load")
    client = node.create_client(SetBool, "served")
    if not client.wait_for_service(START_TIMEOUT_S):
        raise TimeoutError("the subject's service did not appear")
    time.sleep(WARM_UP_S)
    handle: Any = client.handle
    took: list[float] = []
    end = time.monotonic() + seconds
    while (begun := time.monotonic()) < end:
        handle.send_request(SetBool.Request())
        while handle.take_response(SetBool.Response)[0] is None:
            if time.monotonic() - begun > START_TIMEOUT_S:
                raise TimeoutError("the subject's service did not answer")
        took.append(time.monotonic() - begun)
        time.sleep(pause_s)
    node.destroy_node()
    rclpy.shutdown()
    return {"p50_us": 1e6 * statistics.median(took)}


# The conductor.


def start(*arguments: object) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, __file__, *map(str, arguments)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


def finish(process: subprocess.Popen[str]) -> str:
    """End a process by closing its stdin; return its output."""
    output, _ = process.communicate(timeout=START_TIMEOUT_S)
    if process.returncode:
        raise SystemExit(f"{process.args!r} failed with {process.returncode}")
    return output


def measure(name: str, contender: str, seconds: float) -> dict[str, float]:
    """Measure once, with a new subject and a new load; return the values by name."""
    figure = FIGURES[name]
    seconds = max(seconds, figure.shortest_s)
    tested = start("--subject", name, contender, seconds)
    if figure.pause_s is not None:
        caller = start("--call", seconds, figure.pause_s)
        assert caller.stdout is not None
        result = json.loads(caller.stdout.readline())
        finish(caller)
        finish(tested)
    else:
        feeder = start("--publish", figure.hz, int(figure.raw)) if figure.hz else None
        assert tested.stdout is not None
        result = json.loads(tested.stdout.readline())
        if feeder is not None:
            finish(feeder)
        finish(tested)
    return dict(result)


def spread(values: Sequence[float], digits: str) -> str:
    """Return `MEDIAN [LOWEST .. HIGHEST]` as text."""
    low, middle, high = min(values), statistics.median(values), max(values)
    return f"{middle:{digits}} [{low:{digits}} .. {high:{digits}}]"


def show(figure: Figure, rounds: list[dict[str, dict[str, float]]]) -> None:
    """Print the measured values of one figure, without its targets."""
    print(f"\n{figure.title}")
    for contender in rounds[0]:
        values = [results[contender][figure.value] for results in rounds]
        line = f"  {contender:9} {spread(values, ',.2f')} {figure.unit}"
        if figure.hz:
            rates = [results[contender]["messages_per_second"] for results in rounds]
            lost = [results[contender]["lost"] for results in rounds]
            line += f"   at {statistics.median(rates):,.0f} msg/s, lost {max(lost):,.0f}"
        print(line)


def judge(figure: Figure, rounds: list[dict[str, dict[str, float]]]) -> Iterator[tuple[bool, str]]:
    """Yield whether each target of measured contenders was reached, and a line about it."""
    for target in figure.targets:
        if not {target.contender, target.against or target.contender} <= rounds[0].keys():
            continue
        values = [results[target.contender][figure.value] for results in rounds]
        what = target.contender
        if target.against:
            what += f" / {target.against}"
            values = [
                value / results[target.against][figure.value]
                for value, results in zip(values, rounds, strict=True)
            ]
        # What may never happen at all is judged by the worst round, and at the full rate only.
        never = target.limit == 0.0
        judged = max(values) if never else statistics.median(values)
        full = not never or all(
            results[target.contender]["messages_per_second"] >= 0.95 * figure.hz
            for results in rounds
        )
        reached = judged <= target.limit and full
        verdict = "reached" if reached else "NOT REACHED" + ("" if full else ", load too slow")
        line = f"{what:16} {spread(values, '.3f')}   to reach: <= {target.limit:.3f}   {verdict}"
        yield reached, line


def conduct(names: Sequence[str], only: str | None, rounds: int, seconds: float) -> None:
    """Measure the figures in interleaved rounds and print them."""
    results: dict[str, list[dict[str, dict[str, float]]]] = {name: [] for name in names}
    for number in range(rounds):
        for name in names:
            contenders = [c for c in FIGURES[name].contenders if only in (None, c)]
            if contenders:
                print(f"round {number + 1} of {rounds}: {name}", file=sys.stderr)
                results[name].append({c: measure(name, c, seconds) for c in contenders})
    missed: list[str] = []
    judged = 0
    for name, measured in results.items():
        if not measured:
            continue
        show(FIGURES[name], measured)
        for reached, line in judge(FIGURES[name], measured):
            print(f"  {line}")
            judged += 1
            if not reached:
                missed.append(f"  {FIGURES[name].title}: {line}")
    if missed:
        print("\nNot reached:", *missed, sep="\n")
    else:
        print(f"\nReached: {judged} of {judged} targets.")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--figures", default=",".join(FIGURES), help="which, by name, with commas")
    parser.add_argument("--only", help="one contender alone")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=3.0, help="of one measurement")
    parser.add_argument("--domain-id", type=int, default=97)
    parser.add_argument("--subject", nargs=3, help=argparse.SUPPRESS)
    parser.add_argument("--publish", nargs=2, type=float, help=argparse.SUPPRESS)
    parser.add_argument("--call", nargs=2, type=float, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.subject:
        name, contender, seconds = options.subject
        from robotctl.ros.executor import run

        in_loop: Any = run if contender in OURS else asyncio.run
        print(json.dumps(in_loop(subject(name, contender, float(seconds)))), flush=True)
    elif options.publish:
        publish(options.publish[0], bool(options.publish[1]))
    elif options.call:
        print(json.dumps(call(*options.call)), flush=True)
    else:
        os.environ["ROS_DOMAIN_ID"] = str(options.domain_id)
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        names = options.figures.split(",")
        if unknown := set(names) - set(FIGURES):
            parser.error(f"unknown figures {sorted(unknown)}; there are {', '.join(FIGURES)}")
        conduct(names, options.only, options.rounds, options.seconds)


if __name__ == "__main__":
    main()
