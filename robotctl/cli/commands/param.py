"""config, param: check parameter files; show and change the parameters of a running daemon."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from robotctl.base.errors import UsageError
from robotctl.base.paths import DEFAULT_ROBOT
from robotctl.cli.options import ConfigFile, Json, ProfileName, Robot, new_app, new_group
from robotctl.cli.targets.requests import request_source
from robotctl.cli.ui.output import print_answer
from robotctl.cli.ui.text import column_width, json_text, printable, short_path
from robotctl.ipc.answers import ParameterList
from robotctl.ipc.client import call
from robotctl.ipc.method_names import PARAM_LIST, PARAM_SET

app = new_app()
config_group = new_group(app, "config")


@config_group.callback()
def config() -> None:
    """Show and check configuration files, and profiles of robots.

    \b
    Examples:
      robotctl config show --profile turtlebot3 > robot.yaml
      robotctl config validate robot.yaml
    """


@config_group.command()
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
    from robotctl.config import Config, declarations, flat, load

    path = config if profile is None else profile.path
    values, declared = flat(Config() if path is None else load(path)), declarations()
    lines = [
        f"{key}: {json_text(value)}  # {declared[key].about} ({declared[key].allowed})"
        for key, value in values.items()
    ]
    if profile is not None:
        lines = profile.path.read_text(encoding="utf-8").splitlines()
    print_answer(values, lines, as_json=as_json)


@config_group.command()
def validate(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A file for start --config.")],
    as_json: Json = False,
) -> None:
    """Check a configuration file: exit code 0, or 2 with what is wrong and what is allowed.

    \b
    Examples:
      robotctl config validate robot.yaml
    """
    from robotctl.config import Config, flat, load

    config = load(file)
    defaults, values = flat(Config()), flat(config)
    changed = {key: value for key, value in values.items() if value != defaults[key]}
    line = f"{short_path(file)} is valid; changed from the defaults: {len(changed)}"
    print_answer({"file": str(file), "changed": changed}, [line], as_json=as_json)


param_group = new_group(app, "param")


@param_group.callback()
def param() -> None:
    """List, read and change the parameters of the daemon.

    \b
    Examples:
      robotctl param list
      robotctl param get limits.linear_mps
      robotctl param set limits.linear_mps 0.4
      robotctl param dump > robot.yaml
    """


@param_group.command("list")
def list_all(robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Show every parameter: value, allowed values, and when it changes.

    A value that differs from its default has a star.

    \b
    Examples:
      robotctl param list
      robotctl param list --json | jq '.parameters[].key'
    """
    answer = call(robot, PARAM_LIST)
    print_answer(answer, lines(answer), as_json=as_json)


def lines(answer: ParameterList) -> Iterator[str]:
    """Yield a line for each parameter, with a star if the value is not the default."""
    known = answer["parameters"]
    width = column_width([each["key"] for each in known], at_least=10, at_most=40)
    for each in known:
        star = " " if each["value"] == each["default"] else "*"
        value = printable(each["value"])
        yield f"{each['key']:{width}} {star} {value:14} {each['allowed']}; {each['changes']}"


@param_group.command()
def get(
    key: Annotated[str, typer.Argument(metavar="KEY", help="Such as limits.linear_mps.")],
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Show the value of one parameter; --json shows its whole declaration.

    \b
    Examples:
      robotctl param get limits.linear_mps
    """
    known = {each["key"]: each for each in call(robot, PARAM_LIST)["parameters"]}
    if key not in known:
        from difflib import get_close_matches

        near = get_close_matches(key, known, n=1)
        cure = f"did you mean {near[0]}?" if near else "robotctl param list shows all of them"
        raise UsageError(f"{printable(key)}: no such key", cure)
    print_answer(known[key], [printable(known[key]["value"])], as_json=as_json)


@param_group.command("set", context_settings={"ignore_unknown_options": True})
def set_one(
    key: Annotated[str, typer.Argument(metavar="KEY", help="Such as limits.linear_mps.")],
    value: Annotated[str, typer.Argument(metavar="VALUE", help="Its new value.")],
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Change one parameter of the daemon, until the daemon ends.

    The change is recorded, and `replay --check` decides with it. Most parameters change only while
    the robot stands; some only at a start. `robotctl param list` says which.

    \b
    Examples:
      robotctl param set limits.linear_mps 0.4
      robotctl param set pattern.kind circle
    """
    answer = call(
        robot, PARAM_SET, {"key": key, "value": value, "source": request_source("param set")}
    )
    line = f"{key}: {printable(answer['old'])} -> {printable(answer['new'])}"
    print_answer(answer, [line], as_json=as_json)


@param_group.command()
def dump(robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Print all values as a ROS parameter file, for `start --config` and --params-file.

    \b
    Examples:
      robotctl param dump > robot.yaml
    """
    import yaml

    values = {each["key"]: each["value"] for each in call(robot, PARAM_LIST)["parameters"]}
    text = yaml.safe_dump({"/**": {"ros__parameters": values}}, sort_keys=False)
    print_answer(values, [text.rstrip("\n")], as_json=as_json)
