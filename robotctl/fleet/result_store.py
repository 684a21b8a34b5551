"""Results of the gate in a folder: one file each, named by what it was made from, never changed."""

from __future__ import annotations

import json
import os
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Final

from robotctl.errors import Refused
from robotctl.fleet.judgement import Judgement
from robotctl.regular_file import open_regular

MAX_BYTES: Final = 4 << 20


class ResultStore:
    """A folder of results; two gates may use it at once."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def get(self, key: str) -> Judgement | None:
        """Return the result of that name, None if there is none that can be read."""
        try:
            with open_regular(self._folder / f"{key}.json") as file:
                found = Judgement(**json.loads(file.read(MAX_BYTES)))
        except (OSError, ValueError, TypeError, RecursionError):
            return None
        return found if found.key == key else None

    def put(self, result: Judgement) -> Judgement:
        """Store a result unless there is one of its name; return the one that is stored.

        Raises:
            Refused: The folder cannot be written.
        """
        target = self._folder / f"{result.key}.json"
        try:
            self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            with tempfile.NamedTemporaryFile(dir=self._folder, prefix=".result-") as file:
                file.write(json.dumps(result.as_object()).encode())
                file.flush()
                os.fsync(file.fileno())
                with suppress(FileExistsError):
                    os.link(file.name, target)
                    return result
                if (stored := self.get(result.key)) is not None:
                    return stored
                target.unlink()  # damaged
                os.link(file.name, target)
        except OSError as error:
            raise Refused(f"cannot write {target}: {error.strerror or error}") from error
        return result
