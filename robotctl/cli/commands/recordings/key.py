"""key: the keys that seal the recordings of a robot."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from robotctl.base.errors import Refused
from robotctl.base.paths import DEFAULT_ROBOT, chain_to, seal_folder
from robotctl.cli.options import Json, Robot, new_app
from robotctl.cli.ui.output import print_answer
from robotctl.cli.ui.text import moment, printable, short_path

if TYPE_CHECKING:
    from robotctl.recording.seal import StoredKey

app = new_app()
group = new_app()
app.add_typer(group, name="key")


@group.callback()
def key() -> None:
    """Show or change the keys that seal the recordings of a robot.

    \b
    Examples:
      robotctl key show
      robotctl key head
      robotctl key rotate
    """


@group.command()
def show(robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Show the robot's first key, the present one, and the newest head. Shows no secret.

    \b
    Examples:
      robotctl key show
      robotctl key show --json | jq -r .root
    """
    stored = _stored(robot)
    print_answer(_as_object(robot, stored), _lines(robot, stored), as_json=as_json)


@group.command()
def head(robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Show the newest head of the chain: keep it elsewhere, and give it to verify --head.

    It is as new as the last stored link: 10 seconds.

    \b
    Examples:
      robotctl key head
      robotctl verify recordings --head $(robotctl key head)
    """
    stored = _stored(robot)
    if not stored.head.number:
        raise Refused("no recording is sealed yet", "start the robot")
    answer = _as_object(robot, stored)["head"]
    print_answer(answer, [stored.head.digest], as_json=as_json)


@group.command()
def rotate(robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Begin a new chain with a new key, from the next file on; the old key signs for it.

    Keys change with each file by themselves; rotate when others may have read the present one.

    \b
    Examples:
      robotctl key rotate
    """
    from robotctl.recording.seal import Keyring

    _stored(robot)  # a new robot gets its key when it starts
    try:
        stored = Keyring(seal_folder(robot), robot).rotate()
    except (OSError, ValueError) as error:
        raise Refused(f"the key cannot be changed: {error}", "see `robotctl key show`") from error
    print_answer(_as_object(robot, stored), _lines(robot, stored), as_json=as_json)


def _stored(robot: str) -> StoredKey:
    """Return the present key.

    Raises:
        Refused: The robot has no key, or the key cannot be read.
    """
    from robotctl.recording.seal import Keyring

    folder = seal_folder(robot)
    chain_to(folder).check()
    try:
        stored = Keyring(folder, robot).load()
    except (OSError, ValueError) as error:
        raise Refused(
            f"the key of {robot} cannot be read: {error}", "see docs/recordings.md"
        ) from (error)
    if stored is None:
        raise Refused(f"{robot} has no key yet in {folder}", "start the robot")
    return stored


def _as_object(robot: str, stored: StoredKey) -> dict[str, Any]:
    head = stored.head
    return {
        "robot": robot,
        "folder": str(seal_folder(robot)),
        "root": stored.root,
        "key": stored.key,
        "files": stored.files,
        "head": {
            "digest": head.digest,
            "file": head.file,
            "number": head.number,
            "covered": head.covered,
            "time_ns": head.time_ns,
            "closed": head.closed,
        },
    }


def _lines(robot: str, stored: StoredKey) -> Iterator[str]:
    yield f"first key    {stored.root}"
    yield f"present key  {stored.key}"
    yield f"folder       {short_path(seal_folder(robot))}"
    yield f"files        {stored.files}"
    head = stored.head
    if head.number:
        yield f"head         {head.digest}"
        yield f"             {moment(head.time_ns)}, {printable(head.file)}"
