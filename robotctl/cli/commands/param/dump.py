"""param dump: all values as a file for --config."""

from __future__ import annotations

from robotctl.cli.commands.param.group import group
from robotctl.cli.options import Json, Robot
from robotctl.cli.support.answer import print_answer
from robotctl.ipc.client import call
from robotctl.ipc.method_names import PARAM_LIST
from robotctl.paths import DEFAULT_ROBOT


@group.command()
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
