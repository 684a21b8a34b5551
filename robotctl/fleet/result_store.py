"""Results of the gate in a folder or a bucket: an object each, named by what it was made from."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Final

from robotctl.errors import Refused
from robotctl.fleet.judgement import Judgement
from robotctl.store import NoSuchObject, ObjectStore, StoreError, is_url, open_store

MAX_BYTES: Final = 4 << 20

opened_results = cache(open_store)
"""A store stays open for the jobs of a process."""


class ResultStore:
    """The results below a URL or a folder; several gates may use them at once.

    It can be sent to another machine, which then reads and writes the same results.
    """

    def __init__(self, place: str | Path) -> None:
        self._place = str(place) if is_url(str(place)) else str(Path(place).absolute())

    def get(self, key: str) -> Judgement | None:
        """Return the result of that name, None if there is none, or a damaged one.

        Raises:
            Refused: The store cannot be read.
        """
        try:
            found = Judgement(**json.loads(self._store.get(_name(key), MAX_BYTES)))
        except NoSuchObject:
            return None
        except (ValueError, TypeError, RecursionError):
            return None
        except StoreError as error:
            raise _refusal("read", error) from error
        return found if found.key == key else None

    def put(self, result: Judgement) -> Judgement:
        """Store a result unless there is one of its name; return the one that is stored.

        Raises:
            Refused: The store cannot be written.
        """
        name, data = _name(result.key), json.dumps(result.as_object()).encode()
        try:
            if self._store.put_if_absent(name, data):
                return result
            if (stored := self.get(result.key)) is not None:
                return stored
            self._store.put(name, [data])  # it was damaged
        except StoreError as error:
            raise _refusal("write", error) from error
        return result

    @property
    def _store(self) -> ObjectStore:
        return opened_results(self._place)


def _name(key: str) -> str:
    return f"{key}.json"


def _refusal(verb: str, error: StoreError) -> Refused:
    return Refused(f"cannot {verb} results: {error.cause}", error.cure)
