"""config validate: whether a file is a configuration."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from robotctl.cli.options import Json
from robotctl.cli.support.answer import print_answer
from robotctl.cli.terminal.text import short_path
from robotctl.config import Config, flat, load


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
