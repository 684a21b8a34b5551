"""Results of the gate in a folder: a file each, named by what it was made from."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from uuid import uuid4

from robotctl.errors import Refused
from robotctl.fleet.judgement import Judgement
from robotctl.fleet.typed import Typed
from robotctl.regular_file import open_regular
from robotctl.store import StoreError
from robotctl.store.folder_store import FolderStore

MAX_BYTES: Final = 64 << 20


@dataclass(frozen=True, slots=True)
class _Sealed:
    """A result as it is stored, with the SHA-256 of its JSON."""

    sha256: str
    result: dict[str, Any]


_sealed_result, _judgement = Typed(_Sealed), Typed(Judgement)


class ResultStore:
    """The results in a folder; several gates may use them at once.

    It can be sent to another machine, which then reads and writes the same results.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder).absolute()
        self._store = FolderStore(self.folder)

    def __str__(self) -> str:
        """Return the folder."""
        return str(self.folder)

    def get(self, key: str) -> Judgement | None:
        """Return the result of that name, None if there is none, or a damaged one.

        Raises:
            Refused: It cannot be read.
        """
        try:
            with open_regular(self.folder / _name(key)) as file:
                data = file.read(MAX_BYTES + 1)
            if len(data) > MAX_BYTES:
                return None
            result = _opened(data)
        except (FileNotFoundError, ValueError):
            return None
        except OSError as error:
            raise Refused(f"cannot read results: {error}") from error
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
            raise Refused(f"cannot write results: {error.cause}", error.cure) from error
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
            raise Refused(f"cannot write results: {error.cause}", error.cure) from error
        return name

    def has_token(self, name: str) -> bool:
        """Return whether a token is there."""
        return (self.folder / name).is_file()

    def remove_token(self, name: str) -> None:
        """Remove a token.

        Raises:
            Refused: The folder cannot be written.
        """
        try:
            (self.folder / name).unlink(missing_ok=True)
        except OSError as error:
            raise Refused(f"cannot write results: {error}") from error


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
