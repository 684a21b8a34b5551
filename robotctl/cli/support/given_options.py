"""The options given on the command line, as opposed to defaults and environment variables."""

from __future__ import annotations

import typer


def given_options(context: typer.Context) -> dict[str, str]:
    """Return how each parameter that the user typed is spelt, by its name: `{"rate": "--rate"}`."""
    given = {}
    for parameter in context.command.params:
        name = parameter.name or ""
        source = context.get_parameter_source(name)
        if source is not None and source.name == "COMMANDLINE":
            given[name] = parameter.opts[0]
    return given
