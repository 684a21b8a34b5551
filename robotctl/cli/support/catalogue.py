"""Open the catalogue of a folder of recordings for a command."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from robotctl.cli.support.recording_paths import recordings_folder
from robotctl.cli.terminal.progress import progress_bar
from robotctl.errors import Refused, UsageError

if TYPE_CHECKING:
    from robotctl.fleet.catalogue import Catalogue


@contextmanager
def open_catalogue(folder: Path | None, *, quiet: bool) -> Iterator[tuple[Path, Catalogue]]:
    """Yield the folder and its catalogue; recordings without an index are indexed first.

    Raises:
        UsageError: There is no such folder.
        Refused: It cannot be listed, or duckdb is not installed.
    """
    from robotctl.fleet.catalogue import catalogue_of

    if folder is not None and not folder.is_dir():
        raise UsageError(f"{folder}: no such folder")
    place = folder or recordings_folder(None, None)
    try:
        with ExitStack() as stack:
            with progress_bar("indexing", quiet=quiet) as on_progress:
                catalogue = stack.enter_context(catalogue_of(place, on_progress))
            yield place, catalogue
    except OSError as error:
        raise Refused(f"{place} cannot be read: {error.strerror or error}") from error
