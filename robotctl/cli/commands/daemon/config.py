"""config: show and check configurations, and the profiles of known robots."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from robotctl.base.errors import UsageError
from robotctl.cli.options import ConfigFile, Json, ProfileName, new_app
from robotctl.cli.ui.output import print_answer
from robotctl.cli.ui.text import json_text, short_path
from robotctl.config import Config, Declaration, declarations, flat, load


def show(config: ConfigFile = None, profile: ProfileName = None, as_json: Json = False) -> None:
    """Show every key with its value, or the file of a profile, to copy and adapt.

    Without an option these are the defaults. With --json, also of a profile, every key is shown.

    \b
    Examples:
      robotctl config show
      robotctl config show --config robot.yaml
      robotctl config show --profile husky > robot.yaml
    """
    if config is not None and profile is not None:
        raise UsageError("--config with --profile", "choose one of them")
    path = config if profile is None else profile.path
    loaded = Config() if path is None else load(path)
    lines = _lines(loaded)
    if profile is not None:
        lines = iter(profile.path.read_text(encoding="utf-8").splitlines())
    print_answer(flat(loaded), lines, as_json=as_json)


def _lines(config: Config) -> Iterator[str]:
    declared = declarations()
    for key, value in flat(config).items():
        yield f"{key}: {json_text(value)}  # {_comment(declared[key])}"


def _comment(declaration: Declaration) -> str:
    return f"{declaration.about} ({declaration.allowed})"


def validate(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A file for start --config.")],
    as_json: Json = False,
) -> None:
    """Check a configuration file: exit code 0, or 2 with what is wrong and what is allowed.

    \b
    Examples:
      robotctl config validate robot.yaml
    """
    config = load(file)
    defaults, values = flat(Config()), flat(config)
    changed = {key: value for key, value in values.items() if value != defaults[key]}
    line = f"{short_path(file)} is valid; changed from the defaults: {len(changed)}"
    print_answer({"file": str(file), "changed": changed}, [line], as_json=as_json)


app = new_app()
group = new_app()
app.add_typer(group, name="config")


@group.callback()
def config() -> None:
    """Show and check configuration files, and profiles of robots.

    \b
    Examples:
      robotctl config show --profile turtlebot3 > robot.yaml
      robotctl config validate robot.yaml
    """


group.command()(show)
group.command()(validate)
