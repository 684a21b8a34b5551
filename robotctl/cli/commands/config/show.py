"""config show: every key of a configuration, or the file of a profile."""

from __future__ import annotations

from collections.abc import Iterator

from robotctl.cli.options import ConfigFile, Json
from robotctl.cli.support.answer import print_answer
from robotctl.cli.support.profile_option import ProfileName
from robotctl.cli.terminal.text import json_text
from robotctl.config import Config, Declaration, declarations, flat, load
from robotctl.errors import UsageError


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
