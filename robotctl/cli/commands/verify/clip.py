"""verify --source: does a clip hold what its sealed source holds in that time?"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from robotctl.cli.support.answer import print_answer
from robotctl.cli.terminal.progress import progress_bar
from robotctl.cli.terminal.text import moment, row, short_path
from robotctl.errors import Divergence, NotSealed, RobotctlError, UnreadableFile

if TYPE_CHECKING:
    from robotctl.recording.read.seal_chain import SealedFile


def verify_clip(clip: Path, source: Path, *, as_json: bool) -> None:
    """Print whether a clip is a part of its source, and what seals that part.

    Raises:
        Divergence: The clip or the source is not as it was written, or they differ.
        NotSealed: The clip is a part of the source, which is not sealed.
        UnreadableFile: One of them cannot be read.
    """
    from robotctl.recording.keep.clip_origin import compare_with_source
    from robotctl.recording.read.verified import verify_recording

    with progress_bar("reading", quiet=as_json) as on_progress:
        cut = verify_recording(clip)
        whole = verify_recording(source, on_progress)
        origin = compare_with_source(clip, source)
    wrong = [
        *(f"{clip.name}: {sentence}" for sentence in (*cut.whole.wrong, *cut.whole.unreadable)),
        *(f"{source.name}: {sentence}" for sentence in whole.wrong),
        *(f"{clip.name}: {sentence}" for sentence in origin.wrong),
    ]
    links = [
        each
        for file in whole.files
        if (each := _links(file, origin.start_ns, origin.end_ns)) is not None
    ]
    answer: dict[str, Any] = {
        "clip": str(clip),
        "source": str(source),
        "verdict": "broken" if wrong else whole.proof.value,
        "messages": origin.messages,
        "links": links,
        "wrong": wrong,
        "not_proved": origin.not_proved,
    }
    lines = [
        f"{answer['verdict']:12}{short_path(str(clip))}",
        *row(
            "            ",
            f"{origin.messages} messages"
            + ("" if wrong else ", their types and channels, and the metadata")
            + f" are those of {short_path(str(source))}",
        ),
        *(line for each in links for line in row("            ", _link_line(each))),
        *(line for sentence in wrong for line in row("            ", f"wrong: {sentence}")),
        *(line for each in origin.not_proved for line in row("", f"not proved: {each}")),
    ]
    error: RobotctlError | None = None
    if wrong:
        error = Divergence(f"the clip is not proved: {wrong[0]}")
    elif whole.whole.unreadable:
        error = UnreadableFile(f"{source} could not be read completely")
    elif answer["verdict"] == "whole":
        error = NotSealed("the clip is a part of its source, which is not sealed")
    print_answer(answer, lines, as_json=as_json, error=error)


def _links(file: SealedFile, start_ns: int, end_ns: int) -> dict[str, Any] | None:
    """Return the links that seal what a file holds of a time, None if there are none.

    A link seals all that was written before it, so that the one behind the time belongs to them.
    """
    after = [link for link in file.seal.links if link.time_ns >= start_ns]
    if not after or file.seal.links[0].time_ns > end_ns:
        return None
    behind = next((n for n, link in enumerate(after) if link.time_ns >= end_ns), len(after) - 1)
    links = after[: behind + 1]
    return {
        "file": file.path.name,
        "first": links[0].number,
        "last": links[-1].number,
        "from_ns": links[0].time_ns,
        "to_ns": links[-1].time_ns,
        "digest": links[-1].digest.hex(),
    }


def _link_line(links: dict[str, Any]) -> str:
    return (
        f"sealed by the links {links['first']} to {links['last']} of {links['file']}, "
        f"the last at {moment(links['to_ns'])}"
    )
