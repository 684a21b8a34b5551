"""The options of `verify`, and its exit code."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from robotctl.base.errors import Divergence, NotSealed, RobotctlError, UnreadableFile, UsageError
from robotctl.cli.options import Json, new_app
from robotctl.cli.targets.recordings import RecordedBy, file_path
from robotctl.cli.ui.output import print_answer

app = new_app()

_DIGEST_DIGITS = 64


@app.command()
def verify(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE",
            parser=file_path,
            help="An MCAP file, a recording's folder or name, a folder of them, a URL, last.",
        ),
    ],
    head: Annotated[
        str,
        typer.Option(metavar="HEX", help="A head that is known: it must be in what is verified."),
    ] = "",
    source: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            parser=file_path,
            help="The recording that a clip was cut from: all that it took from there is compared.",
        ),
    ] = None,
    robot: RecordedBy = None,
    as_json: Json = False,
) -> None:
    """Show whether recordings are whole and sealed. Reads every byte; needs no ROS.

    The exit code is 0 if all are whole and sealed, 4 if one is whole but not sealed, 6 if one
    cannot be read, and 7 if a byte, the chain or a signature is wrong, or if this machine's list
    of keys knows the file otherwise.

    \b
    Examples:
      robotctl verify last
      robotctl verify recordings
      robotctl verify s3://bucket/robots/run.mcap
      robotctl verify robot_0.mcap --head $(ssh robot robotctl key head)
      robotctl verify stop.mcap --source recordings/robot_20260101_120000
    """
    from robotctl.cli.commands.recordings.replay.select_recordings import select_recordings
    from robotctl.cli.commands.recordings.verify.report import (
        recording_lines,
        summary_lines,
        verify_clip,
        verify_together,
    )

    if source is not None:
        if len(files) != 1 or head:
            raise UsageError("--source takes one clip, and no --head")
        verify_clip(files[0], source, as_json=as_json)
        return
    if head and not (len(head) == _DIGEST_DIGITS and set(head.lower()) <= set("0123456789abcdef")):
        raise UsageError(
            f"--head {head[:80]} is no head", "give 64 digits, as robotctl key head does"
        )
    paths, _ = select_recordings(files, robot, also_urls=True)
    answer = verify_together(paths, head, quiet=as_json)
    lines = [line for report in answer["recordings"] for line in recording_lines(report)]
    lines += summary_lines(answer)
    print_answer(answer, lines, as_json=as_json, error=_gravest(answer))


def _gravest(answer: dict[str, Any]) -> RobotctlError | None:
    reports = answer["recordings"]

    def those(verdict: str, what: str) -> str:
        count = sum(report["verdict"] == verdict for report in reports)
        if len(reports) == 1:
            return f"the recording {what}"
        return f"{count} of {len(reports)} recordings: {what}"

    verdicts = {report["verdict"] for report in reports}
    if "broken" in verdicts:
        return Divergence(those("broken", "is not as it was written"))
    if answer["wrong"]:
        return Divergence(f"the chain is broken: {answer['wrong'][0]}")
    if "unreadable" in verdicts:
        return UnreadableFile(those("unreadable", "could not be read completely"))
    if "whole" in verdicts:
        return NotSealed(those("whole", "is whole, but not sealed"))
    return None
