"""Sends each head (the newest digest of a sealed file) to a topic and to a program."""

from __future__ import annotations

import asyncio
import logging
import shlex
from collections.abc import Callable
from contextlib import suppress
from subprocess import DEVNULL

from robotctl.base.errors import ConfigError
from robotctl.recording.seal import Head

_log = logging.getLogger(__name__)

COMMAND_TIMEOUT_S = 60.0
LAST_TIMEOUT_S = 2.0
"""How long the end of the daemon waits for the program with the last head."""


class HeadForwarder:
    """Publishes each head (newest digest) of a file's seal, and runs a program with it.

    The program's last arguments are the head (hex) and the file's name. Runs skip outdated heads.
    Use it only in the loop's thread.
    """

    def __init__(self, command: str, publish: Callable[[str], object] | None) -> None:
        """`command` is a command line, run without a shell, "" for none.

        Raises:
            ConfigError: The command line is malformed.
        """
        try:
            self._command = shlex.split(command)
        except ValueError as error:
            raise ConfigError(
                f"recording.head_command: {error}",
                "give a program and its arguments, as in a shell",
            ) from error
        self._publish = publish
        self._waiting: Head | None = None
        self._arrived = asyncio.Event()
        self.problem = ""
        """Why the last run of the program failed, or ""."""

    def take(self, head: Head) -> None:
        """Publish a new head of the seal, and schedule a run of the configured program."""
        if self._publish is not None:
            self._publish(head.digest)
        if self._command:
            self._waiting = head
            self._arrived.set()

    async def run(self) -> None:
        """Run the program after each new head, until cancelled."""
        while True:
            await self._arrived.wait()
            await self._forward(COMMAND_TIMEOUT_S)

    async def finish(self) -> None:
        """Run the program for a last head that still waits."""
        await self._forward(LAST_TIMEOUT_S)

    async def _forward(self, timeout_s: float) -> None:
        self._arrived.clear()
        head, self._waiting = self._waiting, None
        if head is None:
            return
        problem = await self._call(head, timeout_s)
        if problem and problem != self.problem:
            _log.warning("%s", problem)
        self.problem = problem

    async def _call(self, head: Head, timeout_s: float) -> str:
        """Run the program, and return its failure or ""."""
        name = f"recording.head_command ({self._command[0]})"
        try:
            process = await asyncio.create_subprocess_exec(
                *self._command,
                head.digest,
                head.file,
                stdin=DEVNULL,
                stdout=DEVNULL,
                stderr=DEVNULL,
            )
        except OSError as error:
            return f"{name} cannot be started: {error.strerror or error}"
        try:
            async with asyncio.timeout(timeout_s):
                code = await process.wait()
        except TimeoutError:
            return f"{name} was ended after {timeout_s:.0f} s"
        finally:
            if process.returncode is None:
                with suppress(ProcessLookupError):
                    process.kill()
                await process.wait()
        return f"{name} ended with {code}" if code else ""
