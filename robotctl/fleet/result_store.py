"""Results of the gate in a folder or a bucket: an object each, named by what it was made from."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final
from uuid import uuid4

from robotctl.errors import Refused
from robotctl.fleet.judgement import Judgement
from robotctl.fleet.typed import Typed
from robotctl.store import NoSuchObject, ObjectStore, StoreError, TooLarge, is_url, open_store

MAX_BYTES: Final = 64 << 20

opened_results = cache(open_store)
"""A store stays open for the jobs of a process."""


@dataclass(frozen=True, slots=True)
class _Sealed:
    """A result as it is stored, with the SHA-256 of its JSON."""

    sha256: str
    result: dict[str, Any]


_sealed_result, _judgement = Typed(_Sealed), Typed(Judgement)


class ResultStore:
    """The results below a URL or a folder; several gates may use them at once.

    It can be sent to another machine, which then reads and writes the same results.
    """

    def __init__(self, place: str | Path) -> None:
        self._place = str(place) if is_url(str(place)) else str(Path(place).absolute())

    def __str__(self) -> str:
        """Return the URL or the folder."""
        return self._place

    def get(self, key: str) -> Judgement | None:
        """Return the result of that name, None if there is none, or a damaged one.

        Raises:
            Refused: The store cannot be read.
        """
        try:
            result = _opened(self._store.get(_name(key), MAX_BYTES))
        except (NoSuchObject, TooLarge, ValueError):
            return None
        except StoreError as error:
            raise _refusal("read", error) from error
        return result if result.key == key else None

    def put(self, result: Judgement) -> Judgement:
        """Store a result unless there is one of its name; return the one that is stored.

        Raises:
            Refused: The store cannot be written.
        """
        name, data = _name(result.key), _sealed(result)
        try:
            if self._store.put_if_absent(name, [data]):
                return result
            if (stored := self.get(result.key)) is not None:
                return stored
            self._store.put(name, [data])  # it was damaged
        except StoreError as error:
            raise _refusal("write", error) from error
        return result

    def put_token(self) -> str:
        """Store an object by which others see that they use the same results; return its name.

        Raises:
            Refused: The store cannot be written.
        """
        name = f"{uuid4().hex}.token"
        try:
            self._store.put(name, [name.encode()])
        except StoreError as error:
            raise _refusal("write", error) from error
        return name

    def has_token(self, name: str) -> bool:
        """Return whether a token is there.

        Raises:
            Refused: The store cannot be read.
        """
        try:
            return self._store.get(name, MAX_BYTES) == name.encode()
        except NoSuchObject:
            return False
        except StoreError as error:
            raise _refusal("read", error) from error

    def remove_token(self, name: str) -> None:
        """Remove a token.

        Raises:
            Refused: The store cannot be written.
        """
        try:
            self._store.delete(name)
        except StoreError as error:
            raise _refusal("write", error) from error

    @property
    def _store(self) -> ObjectStore:
        return opened_results(self._place)


def _sealed(result: Judgement) -> bytes:
    sealed = result.as_object()
    return json.dumps({"sha256": _hash(sealed), "result": sealed}).encode()


def _opened(data: bytes) -> Judgement:
    """Return the result in an object.

    Raises:
        ValueError: It is damaged.
    """
    try:
        found = _sealed_result(json.loads(data))
        if _hash(found.result) != found.sha256:
            raise ValueError("it was changed")
        return _judgement(found.result)
    except RecursionError as error:
        raise ValueError(str(error)) from error


def _hash(result: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(result, sort_keys=True).encode()).hexdigest()


def _name(key: str) -> str:
    return f"{key}.json"


def _refusal(verb: str, error: StoreError) -> Refused:
    return Refused(f"cannot {verb} results: {error.cause}", error.cure)
