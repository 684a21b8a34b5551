"""Open the catalogue of a folder of recordings for a command."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from robotctl.cli.support.recording_paths import recording_path, recordings_folder
from robotctl.cli.ui.output import progress_bar
from robotctl.errors import Refused, UsageError

if TYPE_CHECKING:
    from robotctl.collection.catalogue import Catalogue


@contextmanager
def open_catalogue(given: str | None, *, quiet: bool) -> Iterator[tuple[Path, Catalogue]]:
    """Yield a folder and its catalogue; recordings without an index are indexed first.

    Raises:
        UsageError: There is no such folder, or what is needed is not installed.
        Refused: It cannot be listed.
    """
    from robotctl.collection.catalogue import catalogue_of

    place = recordings_folder(None, None) if given is None else recording_path(given)
    if given is not None and not place.is_dir():
        raise UsageError(f"{place}: no such folder")
    try:
        with ExitStack() as stack:
            with progress_bar("indexing", quiet=quiet) as on_progress:
                catalogue = stack.enter_context(catalogue_of(place, on_progress))
            yield place, catalogue
    except OSError as error:
        raise Refused(f"{place} cannot be read: {error.strerror or error}") from error
