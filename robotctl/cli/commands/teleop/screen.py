"""The live view around teleop, drawn by a thread: a terminal that takes nothing delays no key."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final, cast

from robotctl.cli.commands.watch.polling import POLL_S
from robotctl.cli.support.background import Background
from robotctl.ipc.client import Client
from robotctl.ipc.method_names import STATUS

if TYPE_CHECKING:
    from rich.console import RenderableType

    from robotctl.ipc.answers import Status

MAX_TOPICS: Final = 6
"""They are seen on a terminal of 24 lines; on a smaller one the end of the view is cut off."""

END_S: Final = 1.0
"""How long the terminal may take for the last picture."""


class TeleopScreen:
    """A context that draws the status of the robot, and the lines that `lines()` returns."""

    def __init__(self, robot: str, lines: Callable[[], list[str]]) -> None:
        self._robot = robot
        self._lines = lines
        self._ended = threading.Event()
        self._drawing: Background[None] | None = None

    def __enter__(self) -> TeleopScreen:
        """Begin to draw."""
        self.resume()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop drawing."""
        self.suspend()

    def resume(self) -> None:
        """Draw again."""
        self._ended.clear()
        self._drawing = Background(self._draw)
        self._drawing.start()

    def suspend(self) -> None:
        """Stop drawing while other programs use the terminal."""
        self._ended.set()
        if self._drawing is not None:
            self._drawing.join(END_S)

    def check(self) -> None:
        """Notice that nothing is drawn any more.

        Raises:
            RobotctlError: The status cannot be asked for.
            OSError: The terminal is gone, or there are too many open files.
        """
        if self._drawing is not None and self._drawing.is_done and not self._ended.is_set():
            self._drawing.result()

    def _draw(self) -> None:
        from rich.live import Live

        # Nothing else prints meanwhile, and a redirected stdout would hide its encoding.
        with (
            Client(self._robot) as client,
            Live(auto_refresh=False, redirect_stdout=False, redirect_stderr=False) as live,
        ):
            while not self._ended.is_set():
                live.update(view_below(self._lines(), client.call(STATUS)), refresh=True)
                self._ended.wait(POLL_S)


def view_below(lines: list[str], status: Status) -> RenderableType:
    """Return whole lines of text, with the live view below them: what is cut off is its end."""
    from rich.console import Group
    from rich.text import Text

    from robotctl.cli.terminal.status_panel import live_view

    few: dict[str, Any] = {**status, "topics": status["topics"][:MAX_TOPICS]}
    return Group(*map(Text, lines), live_view(cast("Status", few)))
