"""A daemon seals what it records; a kill costs the seal nothing that was committed."""

from __future__ import annotations

from robotctl.recording import Recording
from tests.support.waiting import until
from tests.support.world import PATIENT, World


def written(world: World) -> int:
    """Return how many messages are in the file."""
    return int(world.answer("record", "status")["recorder"]["written"])


def test_recordings_are_sealed_over_a_kill_and_a_restart(world: World) -> None:
    world.ok("start", "--sim")
    until(lambda: written(world) > 200)
    (pid,) = world.processes()
    world.kill(pid)
    until(lambda: not world.processes())
    (killed,) = world.recordings.iterdir()
    ran = world.robotctl("verify", str(killed))
    assert ran.exit_code == 0, ran
    assert "not closed" in ran.out
    world.ok("start", "--sim")
    until(lambda: written(world) > 50)
    world.ok("stop")
    head = world.ok("key", "head").strip()
    ran = world.robotctl("verify", str(world.recordings), "--head", head)
    assert "broken" not in ran.out
    assert "2 of 2 files" in ran.out
    assert ran.exit_code in (0, 4), ran  # the second start may have repaired the first recording


def test_without_a_place_for_the_key_the_robot_starts_and_says_so(world: World) -> None:
    blocked = world.folder / "state" / "robotctl" / "robot" / "seal"
    blocked.parent.mkdir(parents=True, mode=0o700)
    blocked.write_text("")
    world.ok("start", "--observe")
    until(lambda: any("not sealed" in text for text in world.status()["warnings"]))
    world.ok("stop")
    (folder,) = world.recordings.iterdir()
    with Recording(folder) as recording:
        assert recording.info().missing == ()
    assert world.robotctl("verify", str(folder)).exit_code == 4


def test_heads_are_published_and_given_to_a_program(world: World) -> None:
    kept = world.folder / "kept"
    program = world.folder / "keep"
    program.write_text(f"#!/bin/sh\necho $1 $2 >> {kept}\n")
    program.chmod(0o700)
    settings = f"recording.publish_heads: true\nrecording.head_command: {program}\n"
    world.patient.write_text(PATIENT + settings)
    world.ok("start", "--observe")
    until(lambda: kept.exists() and kept.read_text())
    until(lambda: any(each["name"] == "/robotctl/head" for each in world.status()["topics"]))
    world.ok("stop")
    (folder,) = world.recordings.iterdir()
    head = kept.read_text().splitlines()[-1].split()[0]
    assert head == world.ok("key", "head").strip()
    assert world.robotctl("verify", str(folder), "--head", head).exit_code == 0
