"""A shadow of a real daemon: configured by a file, compared in `status`, recorded, and sealed."""

from __future__ import annotations

from pathlib import Path

from robotctl.kernel.codec import to_json
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.shadow import Shadow
from robotctl.recording import read_info
from robotctl.recording.format.journal import EntryKind, JournalEntry, decode
from robotctl.recording.format.metadata_names import SHADOW_RECORD
from robotctl.rerun.journal_steps import Step, steps
from robotctl.rerun.journal_values import read_event, read_snapshot
from tests.support.waiting import until
from tests.support.world import PATIENT, World, entries_of, read_back


def told_by(world: World, *arguments: str) -> str:
    """The output of a command that succeeds, in one line."""
    ran = world.here(*arguments)
    assert ran.exit_code == 0, ran
    return " ".join(ran.out.split())


def decided_again(recording: Path, head: JournalEntry) -> list[JournalEntry]:
    """What a shadow that begins as `head` says decides differently on the recorded events."""
    first = read_snapshot(head)
    shadow = Shadow(first.params, first.state, ("limits.linear_mps",))
    kernel: Kernel | None = None
    found: list[JournalEntry] = []
    for item in steps(entries_of(recording)):
        if isinstance(item, Step):
            assert kernel is not None
            event = read_event(item.event)
            mine = shadow.step(event, kernel.step(event), kernel.state)
            found += [
                item.event._replace(
                    kind=EntryKind.EFFECT, name=type(effect).__name__, data=to_json(effect)
                )
                for effect in mine or ()
            ]
        elif kernel is None:
            assert isinstance(item, JournalEntry)
            kernel = read_snapshot(item).kernel()
    return found


def test_a_slower_shadow_is_told_and_recorded_and_the_check_stays_the_same(world: World) -> None:
    (world.folder / "slow.yaml").write_text("limits: {linear_mps: 0.1}\n")
    settings = world.folder / "robot.yaml"
    settings.write_text(f"{PATIENT}shadow: slow.yaml\ntracking.max_error_m: 100\n")
    started = world.ok("start", "--sim", "--config", str(settings))
    assert "a shadow decides with" in started
    assert world.status()["shadow"]["differing"] == 0
    world.ok("drive", "line", "--length", "20")
    until(lambda: world.status()["shadow"]["differing"] > 5)
    facts = world.status()["shadow"]
    assert (facts["failure"], facts["mode"]) == ("", "MOVING")
    assert facts["first"]["aspects"] == ["command"]
    assert facts["apart_s"] > 0.0
    told = told_by(world, "status")
    assert "shadow differs in" in told
    assert "rad/s instead of" in told
    world.ok("estop")
    world.ok("stop")
    (recording,) = world.recordings.iterdir()
    record = read_info(recording).metadata[SHADOW_RECORD]
    assert record["parameter.limits.linear_mps"] == "0.1"
    assert record["digest"] == facts["digest"]
    head, *entries = [decode(each.data) for each in read_back(recording)["/robotctl/shadow"]]
    assert head.kind is EntryKind.SNAPSHOT
    assert {entry.name for entry in entries} == {"PublishTwist"}
    assert entries == decided_again(recording, head)
    checked = told_by(world, "replay", "--check", "last")
    assert checked.startswith("same")
    sentence = "a shadow decided with limits.linear_mps 0.1; where it differs is in"
    assert f"note: {sentence} /robotctl/shadow: not checked" in checked
    assert sentence in told_by(world, "info", "last")
    assert "shadow no other decision of the shadow is" in told_by(world, "why")
    told_by(world, "verify", "last")


def test_a_bad_file_of_a_shadow_ends_the_start_with_its_line(world: World) -> None:
    bad = world.folder / "slow.yaml"
    bad.write_text("tracking.k_y: 3\nlimits:\n  linear_mps: 99\n")
    settings = world.folder / "robot.yaml"
    settings.write_text("shadow: slow.yaml\n")
    refused = world.robotctl("start", "--sim", "--config", str(settings))
    assert refused.exit_code == 2
    assert f"{bad}: line 3: limits.linear_mps: 99 is not allowed" in refused.err
