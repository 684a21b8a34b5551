"""Object stores and web servers, by the library obstore (the extra `store`)."""

from __future__ import annotations

import asyncio
import os
import re
from collections.abc import Callable, Coroutine, Iterable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import suppress
from datetime import timedelta
from itertools import chain
from typing import TYPE_CHECKING, Any, Final, Literal, TypeVar

from robotctl.errors import UsageError
from robotctl.printable import printable
from robotctl.store.aws_profile import profile_keys
from robotctl.store.failed_request import ALLOW_HTTP, changed, error_of, short_answer
from robotctl.store.object_store import PART_BYTES
from robotctl.store.request_loop import requests
from robotctl.store.store_errors import BrokenAnswer, NoSuchObject, TooLarge
from robotctl.store.stored_object import NO_STAMP, Stamp, StoredObject, check_key
from robotctl.store.url import StoreUrl

if TYPE_CHECKING:
    from obstore import Attributes, GetOptions, ObjectMeta
    from obstore.store import ClientConfig, RetryConfig

_Result = TypeVar("_Result")

_Request = Callable[[], Coroutine[Any, Any, _Result]]

_PAUSE_S: Final = 0.2
"""Before an answer that broke off is asked for again."""

MAX_RETRIES: Final = 8

_LISTED_AT_ONCE: Final = 1000

NS_PER_S: Final = 1_000_000_000

_SHA256: Final = "sha256"
_WRITTEN: Final = "mtime"
"""The attributes of an object; the second [ns since the epoch] has the name that rclone uses."""


class RemoteStore:
    """The objects below a URL; see `ObjectStore`."""

    def __init__(self, url: StoreUrl) -> None:
        """Open a store; nothing is asked of it yet.

        Raises:
            UsageError: The library is missing, or the URL is wrong.
        """
        try:
            import obstore
            from obstore.store import from_url
        except ImportError as error:
            cure = "pip install 'robotctl[store]'"
            raise UsageError("URLs need obstore, which is not installed", cure) from error
        allow_http = os.environ.get("AWS_ALLOW_HTTP", "").lower() in ("true", "1")
        if url.scheme == "http" and not allow_http:
            raise UsageError(f"{url} would not be encrypted", ALLOW_HTTP)
        self._url = url
        self._library = obstore
        try:
            self._store = from_url(
                url.root,
                config=profile_keys(os.environ) if url.scheme == "s3" else None,
                client_options=_client(allow_http=allow_http),
                retry_config=_retries(),
            )
        except (ValueError, obstore.exceptions.BaseError) as error:
            raise UsageError(f"{url} is not a valid URL") from error

    @property
    def name(self) -> str:
        """Return the URL."""
        return printable(self._url)

    @property
    def can_list(self) -> bool:
        """Return whether it is a bucket: a web server does not tell what it has."""
        return self._url.scheme not in ("https", "http")

    def list(self, prefix: str = "") -> Iterator[StoredObject]:
        """Yield the objects below the folder `prefix`, and below its folders."""
        if prefix:
            check_key(prefix)
        below = "/".join(part for part in (self._url.path, prefix) if part)
        stream = self._library.list(self._store, below or None, chunk_size=_LISTED_AT_ONCE)

        async def listed() -> Sequence[ObjectMeta]:
            try:
                return await anext(stream)
            except StopAsyncIteration:
                return ()

        skipped = len(self._url.path) + 1 if self._url.path else 0
        while found := self._run(listed, prefix):
            for meta in found:
                yield _described(meta, meta["path"][skipped:])

    def head(self, key: str) -> StoredObject:
        """Return what is known about an object."""

        async def asked() -> StoredObject:
            options: GetOptions = {"head": True}
            answer = await self._library.get_async(self._store, self._path(key), options=options)
            return _described(answer.meta, key, answer.attributes)

        return self._run(asked, key)

    def get_range(self, found: StoredObject, begin: int, end: int) -> bytes:
        """Return exactly the bytes from `begin` to before `end` of the object that was found."""
        return requests().run(self._range(found, begin, end))

    def start_range(self, found: StoredObject, begin: int, end: int) -> Future[bytes]:
        """Start `get_range`, and return its result to come."""
        return requests().start(self._range(found, begin, end))

    async def _range(self, found: StoredObject, begin: int, end: int) -> bytes:
        if begin >= end:
            return b""
        path, where = self._path(found.key), self._where(found.key)
        options: GetOptions = {"range": (begin, end)}
        if found.etag.startswith('"'):  # a weak one never matches
            options["if_match"] = found.etag

        async def ranged() -> bytes:
            answer = await self._library.get_async(self._store, path, options=options)
            if _described(answer.meta, found.key) != found:
                raise changed(where)
            data = bytes(await answer.bytes_async())
            if len(data) != end - begin:
                raise short_answer(where, len(data), end - begin)
            return data

        # The library continues an answer that broke off only if it knows a strong etag.
        with suppress(BrokenAnswer):
            return await self._told(ranged, found.key)
        await asyncio.sleep(_PAUSE_S)
        return await self._told(ranged, found.key)

    def get(self, key: str, max_bytes: int) -> bytes:
        """Return a whole object."""
        found = self.head(key)
        if found.size_bytes > max_bytes:
            raise TooLarge(f"{self._where(key)} has {found.size_bytes} bytes: that is too many")
        return self.get_range(found, 0, found.size_bytes)

    def put_if_absent(self, key: str, parts: Iterable[bytes], stamp: Stamp = NO_STAMP) -> bool:
        """Store an object under a free name; return whether it was free.

        No store has a condition for an object in several parts: another process that stores a
        large one of the same name at the same time is not noticed.
        """
        begin, rest = _beginning(parts)
        if len(begin) <= PART_BYTES:
            return self._put(key, begin, stamp, mode="create")
        with suppress(NoSuchObject):
            self.head(key)
            return False
        return self._put(key, chain((begin,), rest), stamp)

    def put(self, key: str, parts: Iterable[bytes], stamp: Stamp = NO_STAMP) -> None:
        """Store an object from parts of any length, and replace one of that name."""
        begin, rest = _beginning(parts)
        self._put(key, begin if len(begin) <= PART_BYTES else chain((begin,), rest), stamp)

    def _put(
        self,
        key: str,
        content: bytes | Iterable[bytes],
        stamp: Stamp,
        mode: Literal["create", "overwrite"] = "overwrite",
    ) -> bool:
        async def stored() -> bool:
            try:
                await self._library.put_async(
                    self._store,
                    self._path(key),
                    content,
                    attributes=_attributes(stamp),
                    mode=mode,
                    use_multipart=not isinstance(content, bytes),
                    chunk_size=PART_BYTES,
                    max_concurrency=2,
                )
            except self._library.exceptions.AlreadyExistsError:
                return False
            return True

        return self._run(stored, key)

    def delete(self, key: str) -> None:
        """Remove an object; one that does not exist is no error."""

        async def removed() -> None:
            try:
                await self._library.delete_async(self._store, self._path(key))
            except FileNotFoundError:  # S3 does not tell
                return

        self._run(removed, key)

    def _run(self, request: _Request[_Result], key: str) -> _Result:
        return requests().run(self._told(request, key))

    async def _told(self, request: _Request[_Result], key: str) -> _Result:
        try:
            return await request()
        except (self._library.exceptions.BaseError, FileNotFoundError, ValueError) as error:
            raise error_of(error, self._url.scheme, self._where(key)) from None

    def _path(self, key: str) -> str:
        check_key(key)
        return f"{self._url.path}/{key}" if self._url.path else key

    def _where(self, key: str) -> str:
        return f"{self.name}/{printable(key)}" if key else self.name


def _described(meta: ObjectMeta, key: str, attributes: Attributes | None = None) -> StoredObject:
    etag = meta["e_tag"] or f"of {meta['last_modified'].isoformat()}"
    stored_with = attributes or {}
    written_ns = str(stored_with.get(_WRITTEN, ""))
    modified_ns = int(meta["last_modified"].timestamp() * NS_PER_S)
    if re.fullmatch(r"\d{1,19}", written_ns):
        modified_ns = int(written_ns)
    return StoredObject(key, meta["size"], etag, modified_ns, str(stored_with.get(_SHA256, "")))


def _attributes(stamp: Stamp) -> Attributes:
    return {_SHA256: stamp.sha256, _WRITTEN: str(stamp.modified_ns)} if stamp.sha256 else {}


def _beginning(parts: Iterable[bytes]) -> tuple[bytes, Iterator[bytes]]:
    """Return more than a part of an object, or all of it, and the rest."""
    begin, rest = bytearray(), iter(parts)
    while len(begin) <= PART_BYTES and (part := next(rest, None)) is not None:
        begin += part
    return bytes(begin), rest


def _client(*, allow_http: bool) -> ClientConfig:
    return {
        "allow_http": allow_http,
        "connect_timeout": timedelta(seconds=5),
        # Without a byte: a large part may take long on a thin line.
        "read_timeout": timedelta(seconds=20),
        "timeout": timedelta(minutes=10),
    }


def _retries() -> RetryConfig:
    return {
        "max_retries": MAX_RETRIES,
        "retry_timeout": timedelta(seconds=20),
        "backoff": {
            "init_backoff": timedelta(milliseconds=50),
            "max_backoff": timedelta(seconds=3),
            "base": 2,
        },
    }
