"""A server of the protocol in a process of its own: ours, or that of the Foxglove SDK.

    python -m viewing.servers ours|sdk RATE_HZ SECONDS BYTES

Prints its port; after a line on stdin it publishes, then prints {"cpu_s", "rss_before",
"rss_after", "sent"} as JSON.
"""

from __future__ import annotations

import asyncio
import json
import os
import sys
import time
from collections.abc import Callable

TOKEN = "benchmark"
DEFINITION = "uint8[] data\n"
TYPE = "std_msgs/msg/UInt8MultiArray"

Publish = Callable[[int, bytes], object]


def resident_bytes() -> int:
    """The memory of this process."""
    with open("/proc/self/statm") as statm:
        return int(statm.read().split()[1]) * 4096


async def publish_regularly(
    publish: Publish, rate_hz: float, seconds: float, size: int
) -> dict[str, float]:
    """Publish messages with the present time, and return what that cost."""
    payload = bytes(size)
    before, cpu_s, began_s = resident_bytes(), time.process_time(), time.monotonic()
    count = round(rate_hz * seconds)
    for number in range(count):
        wait_s = began_s + number / rate_hz - time.monotonic()
        await asyncio.sleep(max(wait_s, 0.0))
        publish(time.time_ns(), payload)
    await asyncio.sleep(0.2)
    return {
        "cpu_s": time.process_time() - cpu_s,
        "rss_before": before,
        "rss_after": resident_bytes(),
        "sent": count,
    }


async def started(port: int) -> None:
    """Tell the port, and wait for the line."""
    print(port, flush=True)
    await asyncio.to_thread(sys.stdin.readline)


async def ours(rate_hz: float, seconds: float, size: int) -> dict[str, float]:
    """Serve by robotctl."""
    from robotctl.view.admission import Admission
    from robotctl.view.view_server import ViewServer

    server = ViewServer("benchmark", Admission(TOKEN))
    port = await server.listen("127.0.0.1", 0)
    channel = server.offer("/data", TYPE, DEFINITION)
    running = asyncio.create_task(server.run())
    await started(port)
    try:
        return await publish_regularly(
            lambda at_ns, data: server.publish(channel, at_ns, data), rate_hz, seconds, size
        )
    finally:
        running.cancel()


async def sdk(rate_hz: float, seconds: float, size: int) -> dict[str, float]:
    """Serve by the SDK."""
    import foxglove
    from foxglove import Channel, Schema

    server = foxglove.start_server(name="benchmark", host="127.0.0.1", port=0)
    schema = Schema(name=TYPE, encoding="ros2msg", data=DEFINITION.encode())
    channel = Channel("/data", schema=schema, message_encoding="cdr")
    await started(server.port)
    return await publish_regularly(
        lambda at_ns, data: channel.log(data, log_time=at_ns), rate_hz, seconds, size
    )


def main() -> None:
    """Serve once."""
    which, rate_hz, seconds, size = sys.argv[1:]
    serve = {"ours": ours, "sdk": sdk}[which]
    print(json.dumps(asyncio.run(serve(float(rate_hz), float(seconds), int(size)))), flush=True)
    os._exit(0)  # the SDK waits for stalled viewers


if __name__ == "__main__":
    main()
