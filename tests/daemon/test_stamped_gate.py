"""One process a role, with a base that takes TwistStamped."""

from __future__ import annotations

from pathlib import Path

import pytest

from robotctl.cdr.motion import frame_id_of
from robotctl.kernel.command_types import TWIST_STAMPED
from robotctl.recording import Recording
from tests.support.arrangement import PATIENT_GATE, PATIENT_OWNER, Arrangement
from tests.support.bags import padded
from tests.support.waiting import until
from tests.support.world import World

COMMANDS = ("/cmd_vel", "/cmd_vel/owner")


@pytest.mark.parametrize(
    "stamped",
    [(), pytest.param(("-p", "command.stamped:=true"), marks=pytest.mark.slow)],
)
def test_the_gate_passes_twist_stamped_on_to_a_base_that_takes_it(
    world: World, stamped: tuple[str, ...]
) -> None:
    settings = world.folder / "base.yaml"
    settings.write_text("command: {stamped: true, frame_id: base_footprint}\n")
    roles = Arrangement(world)
    base = roles.sim("--config", str(settings))
    assert base.stdout is not None
    assert base.stdout.readline()  # an owner that starts before the base chooses Twist
    roles.gate(*PATIENT_GATE)
    roles.owner(*PATIENT_OWNER, *stamped, "-p", "command.frame_id:=base_footprint")
    roles.until_complete()
    until(lambda: roles.status()["velocity"]["linear"] > 0.05)
    world.ok("set-mode", "idle")
    world.ok("stop")
    roles.end()
    assert "passing on geometry_msgs/msg/TwistStamped" in world.role_log("velocity_publisher")
    (report,) = world.answer("replay", "last", "--check")["recordings"]
    assert (report["verdict"], report["commands"] > 0) == ("same", True)
    topics = {(each["name"], each["type"]): each for each in world.answer("info", "last")["topics"]}
    for name in COMMANDS:
        assert topics[name, TWIST_STAMPED]["count"] > 0
    (file,) = (world.folder / "recordings").glob("*/*.mcap")
    with Recording(file) as recording:
        passed = [
            each for each in recording.messages({"/cmd_vel"}, pytest.fail) if any(each.data[-48:])
        ]
    assert {frame_id_of(each.data) for each in passed} == {"base_footprint"}
    check_replay(world, file.parent)


def commands_of(folder: Path) -> dict[str, list[bytes]]:
    """Return topic -> commands of the base's type; the gate sends Twist before it knows that."""
    found: dict[str, list[bytes]] = {topic: [] for topic in COMMANDS}
    with Recording(folder) as recording:
        for each in recording.messages(COMMANDS, pytest.fail):
            if each.type_name == TWIST_STAMPED:
                found[each.topic].append(padded(each.data))
    return found


def check_replay(world: World, first: Path) -> None:
    """A replay withholds both commands; asked for by name, each is published as it was recorded."""
    by_default = world.answer("replay", str(first), "--rate", "max")
    assert set(COMMANDS) <= set(by_default["withheld"]), by_default
    world.ok("start", "--observe")
    named = ("--topics", ",".join(COMMANDS), "--wait-for", "2", "--rate", "max")
    said = world.answer("replay", str(first), *named)
    recorded = commands_of(first)
    assert (said["withheld"], said["failed"]) == ({}, 0)
    counts = {topic: len(commands) for topic, commands in recorded.items()}
    assert said["sent"] == sum(counts.values())
    until(
        lambda: (
            counts.items()
            <= {each["name"]: each["count"] for each in world.status()["topics"]}.items()
        )
    )
    world.ok("stop")
    (second,) = set(world.recordings.iterdir()) - {first}
    assert commands_of(second) == recorded
