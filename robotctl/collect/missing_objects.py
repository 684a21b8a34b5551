"""What a store lacks of a recording: a pure function of the files here and the objects there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from robotctl.collect.manifest import CollectedFile, Manifest
from robotctl.collect.object_names import CollectedRecording


@dataclass(frozen=True, slots=True)
class Missing:
    """What to copy: the files, then the manifest with its number; None if there is one already.

    `wrong` are objects whose size is not that of their name's file: they are never replaced.
    `lost` are files that are neither here nor there, though a manifest names them.
    """

    files: tuple[CollectedFile, ...]
    manifest: Manifest | None
    number: int
    wrong: tuple[CollectedFile, ...]
    lost: tuple[CollectedFile, ...]


def missing_of(
    here: Manifest, there: CollectedRecording, newest: Callable[[], Manifest]
) -> Missing:
    """Compare a recording with the objects of its name; `newest` reads the newest manifest.

    Files that retention has removed here stay in the manifest. Then only further data is added to
    it: the list and the index that the recording has now tell less than those in the store.
    """
    number = 0 if there.manifest is None else there.manifest.manifest_number
    wanted = here
    if number and there.manifest != here.name(number):
        before = newest()
        wanted = before.united(here.data() if before.lost_data(here) else here)
    here_too = {(file.name, file.sha256) for file in here.files}
    sizes = {file: there.objects.get(wanted.object_of(file)) for file in wanted.files}
    absent = [file for file, size in sizes.items() if size is None]
    return Missing(
        files=tuple(file for file in absent if (file.name, file.sha256) in here_too),
        manifest=None if there.manifest == wanted.name(number) else wanted,
        number=number + 1,
        wrong=tuple(
            file for file, size in sizes.items() if size is not None and size != file.size_bytes
        ),
        lost=tuple(file for file in absent if (file.name, file.sha256) not in here_too),
    )
