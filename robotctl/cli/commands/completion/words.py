"""completion words: what the scripts of the shells call."""

from __future__ import annotations

from typing import Annotated

import typer


def words(
    context: typer.Context,
    typed: Annotated[list[str] | None, typer.Argument(metavar="[-- WORDS...]")] = None,
) -> None:
    """Print what the last of the words may become, one a line, with its meaning after a tab."""
    from robotctl.cli.completion.candidates import candidates

    for word, meaning in candidates(context.find_root().command, typed or []):
        print(f"{word}\t{meaning}" if meaning else word)
