# mypy: disallow-untyped-calls=False
"""Waiting for services, with deadlines and messages that say what was waited for."""

from __future__ import annotations

import asyncio
from typing import Any

from rclpy.action.client import ActionClient
from rclpy.client import Client

from robotctl.ros.executor import futures

SERVICE_POLL_S = 0.02


async def call(client: Client, request: Any, timeout_s: float | None) -> Any:
    """Send a request and return its response.

    Raises:
        TimeoutError: No response came within `timeout_s` seconds (None: no deadline).
    """
    try:
        async with asyncio.timeout(timeout_s) as deadline:
            return await futures.wait(client.call_async(request))
    except TimeoutError:
        if not deadline.expired():
            raise
        raise TimeoutError(
            f"no response from service {client.srv_name} within {timeout_s:g} s; "
            "is its node running?"
        ) from None


async def wait_for_service(client: Client | ActionClient, timeout_s: float | None) -> None:
    """Wait until a server for the client is discovered.

    Raises:
        TimeoutError: None was within `timeout_s` seconds (None: no deadline).
    """
    if isinstance(client, ActionClient):
        ready, name = client.server_is_ready, client._action_name
    else:
        ready, name = client.service_is_ready, client.srv_name
    try:
        async with asyncio.timeout(timeout_s):
            while not ready():  # noqa: ASYNC110 - the graph has no callback
                await asyncio.sleep(SERVICE_POLL_S)
    except TimeoutError:
        raise TimeoutError(
            f"no server for {name} within {timeout_s:g} s; is its node running?"
        ) from None
