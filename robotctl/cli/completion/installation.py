"""Make a shell complete robotctl from its next start on."""

from __future__ import annotations

from pathlib import Path

from robotctl.cli.completion.scripts import Shell
from robotctl.errors import Refused

BEGIN, END = "# robotctl completion: begin\n", "# robotctl completion: end\n"
"""The script stands between these lines of the start file."""


def install(shell: Shell, home: Path) -> Path:
    """Write the script into the shell's start file, in the place of an older one; return the file.

    Raises:
        Refused: The file cannot be read or written.
    """
    path = shell.start_file(home)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        old = path.read_text(errors="surrogateescape") if path.exists() else ""
        new = with_script(old, shell.script)
        if new.startswith(old):  # most often: no other content is at risk
            with path.open("a", errors="surrogateescape") as file:
                file.write(new[len(old) :])
        else:
            path.write_text(new, errors="surrogateescape")
    except OSError as error:
        raise Refused(f"{path} cannot be changed: {error.strerror}") from error
    return path


def with_script(text: str, script: str) -> str:
    """Return the text of a start file with the script, once."""
    block = f"{BEGIN}{script}{END}"
    head, begin, rest = text.partition(BEGIN)
    _, end, tail = rest.partition(END)
    if begin and end:
        return f"{head}{block}{tail}"
    gap = "" if not text or text.endswith("\n") else "\n"
    return f"{text}{gap}{block}"
