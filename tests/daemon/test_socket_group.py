"""`socket.group` with the real daemon and the command line of a member."""

from __future__ import annotations

import grp

from tests.support.users import as_root, process_of
from tests.support.waiting import DEADLINE_S
from tests.support.world import World

MEMBER = 65502

IMPORTS = """
from robotctl.cli import app, quick
from robotctl.cli.targets import robots
"""


@as_root
def test_a_member_of_the_group_stops_the_robot_and_the_journal_names_the_user(world: World) -> None:
    group = grp.getgrgid(100)
    world.folder.chmod(0o711)
    (world.folder / "run").chmod(0o711)
    config = world.folder / "robot.yaml"
    config.write_text(f"socket.group: {group.gr_name}\n")
    started = world.ok("start", "--sim", "--config", str(config))
    assert f"each member of group {group.gr_name} may give commands (socket.group)" in started
    member = process_of(
        MEMBER, [group.gr_gid], IMPORTS, "raise SystemExit(app.run(['estop']))", world.environment
    )
    out, err = member.communicate(timeout=DEADLINE_S)
    assert (member.returncode, out.startswith("Mode changed to EMERGENCY_STOP")) == (0, True), err
    assert f") of uid {MEMBER}: " in world.status()["mode_reason"]
    world.ok("stop")


def test_an_unknown_group_is_refused_by_name_and_nothing_starts(world: World) -> None:
    config = world.folder / "robot.yaml"
    config.write_text("socket.group: no_such_group\n")
    refused = world.robotctl("start", "--sim", "--config", str(config))
    assert refused.exit_code == 2
    assert "there is no group 'no_such_group'" in refused.err
    assert world.robotctl("status").exit_code == 3
