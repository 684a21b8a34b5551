"""A process that calls /set_mode at a rate, and waits for no answer before the next call.

It requests MOVING and a mode that does not exist, in turn: only the measurement stops the robot.
Ends when its stdin is closed, and prints the rates that it reached.
"""

from __future__ import annotations

import asyncio
import json
import sys
import time
from typing import Any

CALLS = (1, 9)
PERIOD_S = 0.002


async def flood(rate: float) -> dict[str, float]:
    """Call until stdin is closed; return calls and answers per second."""
    from rclpy.context import Context
    from rclpy.node import Node
    from robot_controller.srv import SetMode

    from robotctl.ros import AsyncioExecutor

    context = Context()
    context.init(args=[])
    node = Node("flood", context=context)
    answered = 0

    def count(_: Any) -> None:
        nonlocal answered
        answered += 1

    async with AsyncioExecutor(context) as executor:
        executor.add_node(node)
        client = node.create_client(SetMode, "/set_mode")
        while not client.service_is_ready():  # noqa: ASYNC110 - the daemon is elsewhere
            await asyncio.sleep(0.05)
        print("ready", flush=True)
        end = asyncio.create_task(asyncio.to_thread(sys.stdin.read))
        sent, begun = 0, time.monotonic()
        while not end.done():
            while sent < (time.monotonic() - begun) * rate:
                client.call_async(
                    SetMode.Request(requested_mode=CALLS[sent % 2])
                ).add_done_callback(count)
                sent += 1
            await asyncio.sleep(PERIOD_S)
        took_s = time.monotonic() - begun
    node.destroy_node()
    context.try_shutdown()
    return {"calls": sent / took_s, "answers": answered / took_s}


if __name__ == "__main__":
    print(json.dumps(asyncio.run(flood(float(sys.argv[1])))), flush=True)
