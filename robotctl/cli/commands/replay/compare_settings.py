"""Compare recordings with runs under other parameters: shared by `what_if` and `resim`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from robotctl.cli.commands.replay.select_recordings import select_recordings, skipped_lines
from robotctl.cli.support.answer import print_answer
from robotctl.cli.terminal.progress import Progress, progress_bar
from robotctl.cli.terminal.text import printable, row, short_path
from robotctl.errors import UnreadableFile, UsageError
from robotctl.rerun.recorded_settings import Settings, check_scope, parse_settings

_LABEL_WIDTH, _COLUMN_WIDTH = 26, 14


def compare_settings(
    files: Sequence[Path],
    settings: Sequence[str],
    robot: str | None,
    compare: Callable[[Path, Settings, Progress], dict[str, Any]],
    lines: Callable[[dict[str, Any]], Iterator[str]],
    *,
    closed_loop: bool,
    as_json: bool,
) -> None:
    """Compare each recording with a run under `settings`, and print the tables or one object.

    An argument among `files` that has an equals sign and names no file is one more setting.

    Raises:
        UsageError: A setting is not allowed, or there is none.
        UnreadableFile: A recording could not be read completely.
    """
    more = [str(file) for file in files if "=" in file.name and not file.exists()]
    files = [file for file in files if str(file) not in more]
    if not files:
        raise UsageError("give a recording: robotctl replay FILE --what-if KEY=VALUE")
    parsed = parse_settings([*settings, *more])
    check_scope(parsed, closed_loop=closed_loop)
    found = []
    paths, skipped = select_recordings(files, robot)
    for path in paths:
        with progress_bar(short_path(path), quiet=as_json) as on_progress:
            found.append(compare(path, parsed, on_progress))
        if not as_json:
            print("\n".join(lines(found[-1])), flush=True)
    if skipped and not as_json:
        print("\n".join(skipped_lines(skipped)), flush=True)
    incomplete = [each for each in found if each["missing"]]
    error = None
    if incomplete:
        error = UnreadableFile(
            f"{len(incomplete)} of {len(found)} recordings could not be read completely"
        )
    if as_json:
        answer = {"recordings": found, "skipped": list(map(str, skipped))}
        print_answer(answer, (), as_json=True, error=error)
    elif error is not None:
        raise error


def settings_lines(settings: Mapping[str, Mapping[str, object]]) -> Iterator[str]:
    """Yield a table of the settings, recorded and changed."""
    yield ""
    yield table_row("", ["recorded", "what if"])
    for key, values in settings.items():
        yield table_row(key, [printable(values[side]) for side in ("recorded", "what_if")])


def table_row(label: str, cells: Sequence[str]) -> str:
    """Return one row of a table."""
    columns = "".join(f"{cell:>{_COLUMN_WIDTH}}" for cell in cells)
    return f"  {label:{_LABEL_WIDTH}}{columns}".rstrip()


def missing_lines(found: Mapping[str, Any]) -> Iterator[str]:
    """Yield what could not be read of a recording."""
    for sentence in found["missing"]:
        yield from row("  ", f"missing: {sentence}")
