"""Calls of systemctl."""

from __future__ import annotations

import subprocess

from robotctl.cli.terminal.text import printable

CALL_S = 60.0
"""Longer than a daemon takes to be ready or to end."""


def systemctl(scope: tuple[str, ...], *words: str) -> str:
    """Run systemctl; return why it failed, "" if it did not."""
    try:
        done = subprocess.run(
            ("systemctl", *scope, *words), capture_output=True, text=True, timeout=CALL_S
        )
    except FileNotFoundError:
        return "there is no systemctl on this machine"
    except subprocess.TimeoutExpired:
        return f"no answer within {CALL_S:g} s"
    text = " ".join(done.stderr.split())
    return printable(text or f"exit code {done.returncode}") if done.returncode else ""
