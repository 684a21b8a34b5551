"""Object stores and web servers, through the library obstore (the extra `store`)."""

from __future__ import annotations

import asyncio
import atexit
import os
import re
import threading
import time
from collections.abc import Callable, Coroutine, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from configparser import ConfigParser, Error
from contextlib import suppress
from datetime import timedelta
from functools import cache
from itertools import chain
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, TypeVar

from robotctl.base.errors import UsageError
from robotctl.base.store.objects import (
    NO_STAMP,
    PART_BYTES,
    AccessDenied,
    BrokenAnswer,
    NoSuchObject,
    Stamp,
    StoredObject,
    StoreError,
    StoreFailed,
    StoreUrl,
    changed,
    check_key,
    short_answer,
)
from robotctl.base.text import printable, short_name

if TYPE_CHECKING:
    from obstore import Attributes, GetOptions, ObjectMeta
    from obstore.store import ClientConfig, RetryConfig, S3Config

_Result = TypeVar("_Result")

_Request = Callable[[], Coroutine[Any, Any, _Result]]

_PAUSE_S: Final = 0.2
"""The pause before a broken answer is requested again."""

MAX_RETRIES: Final = 8

_LISTED_AT_ONCE: Final = 1000

NS_PER_S: Final = 1_000_000_000

_SHA256: Final = "sha256"
_WRITTEN: Final = "mtime"
"""The attribute with the time of writing [ns since the epoch], as in rclone."""

_LIBRARY_LETS_GO_S: Final = 0.5
"""The time for the library's threads to end after a cancellation, as they cannot be joined."""

_CREDENTIALS: Final = {
    "s3": "set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY; for a public bucket "
    "AWS_SKIP_SIGNATURE=true",
    "gs": "set GOOGLE_APPLICATION_CREDENTIALS; for a public bucket GOOGLE_SKIP_SIGNATURE=true",
    "az": "set AZURE_STORAGE_ACCOUNT_NAME and AZURE_STORAGE_ACCOUNT_KEY",
}
_OF_THE_SERVER: Final = "only files that everybody may read can be read through https"

ALLOW_HTTP: Final = "use https, or set AWS_ALLOW_HTTP=true for a network that you trust"

_BROKEN: Final = re.compile(r"kind: (Body|Decode|Interrupted)\b|IncompleteMessage|UnexpectedRange")

_REASONS: Final = {
    "ConnectionRefused": "the server refuses the connection",
    "dns error": "there is no such host",
    "InvalidContentType": "the server does not speak https",
    "UnknownIssuer": "the certificate of the server is not trusted",
    "certificate": "the certificate of the server is not valid",
    "TimedOut": "the server does not answer in time",
    "kind: Timeout": "the server does not answer in time",
    "NotPartial": "the server cannot send parts of a file",
    "RangeNotSupported": "the server cannot send parts of a file",
    "CONTENT_RANGE": "the server claims a size that no file can have",
    "Connect": "the server cannot be reached",
}
"""Words in an error text and their meaning, of which the first applies."""

_INSTANCE_METADATA: Final = re.compile(
    r"169\.254\.169\.254|metadata\.google|metadata\.azure|SharedKeyCredential|MissingKey"
)

_OTHER_SOURCES: Final = frozenset(
    {
        "AWS_ACCESS_KEY_ID",
        "AWS_SKIP_SIGNATURE",
        "AWS_WEB_IDENTITY_TOKEN_FILE",
        "AWS_CONTAINER_CREDENTIALS_RELATIVE_URI",
        "AWS_CONTAINER_CREDENTIALS_FULL_URI",
    }
)
_DEFAULT: Final = "default"


class RemoteStore:
    """The objects below a URL; see `ObjectStore`."""

    def __init__(self, url: StoreUrl) -> None:
        """Open a store; no request is sent yet.

        Raises:
            UsageError: The library is missing, or the URL is invalid or not encrypted.
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

    def list(self, prefix: str = "") -> Iterator[StoredObject]:
        """Yield the objects below the folder `prefix`, at any depth."""
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
        """Return size, etag, time and stored hash of an object."""

        async def asked() -> StoredObject:
            options: GetOptions = {"head": True}
            answer = await self._library.get_async(self._store, self._path(key), options=options)
            return _described(answer.meta, key, answer.attributes)

        return self._run(asked, key)

    def get_range(self, found: StoredObject, begin: int, end: int) -> bytes:
        """Return bytes `begin` to `end` - 1 of `found`; raise ObjectChanged if it was changed."""
        return requests().run(self._range(found, begin, end))

    async def _range(self, found: StoredObject, begin: int, end: int) -> bytes:
        if begin >= end:
            return b""
        path, where = self._path(found.key), self._where(found.key)
        options: GetOptions = {"range": (begin, end)}
        if found.etag.startswith('"'):  # a weak etag never matches
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

    def put_if_absent(self, key: str, parts: Iterable[bytes], stamp: Stamp = NO_STAMP) -> bool:
        """Store an object under an unused key; return whether it was stored.

        An object larger than PART_BYTES may replace one that another process stores meanwhile.
        """
        begin, rest = _beginning(parts)
        if len(begin) <= PART_BYTES:
            return self._put(key, begin, stamp, mode="create")
        with suppress(NoSuchObject):
            self.head(key)
            return False
        return self._put(key, chain((begin,), rest), stamp)

    def put(self, key: str, parts: Iterable[bytes], stamp: Stamp = NO_STAMP) -> None:
        """Store `parts`, of any length, as the object `key`; an existing object is replaced."""
        begin, rest = _beginning(parts)
        self._put(key, begin if len(begin) <= PART_BYTES else chain((begin,), rest), stamp)

    def _put(
        self,
        key: str,
        content: bytes | Iterable[bytes],
        stamp: Stamp,
        mode: Literal["create", "overwrite"] = "overwrite",
    ) -> bool:
        attributes: Attributes = {}
        if stamp.sha256:
            attributes = {_SHA256: stamp.sha256, _WRITTEN: str(stamp.modified_ns)}

        async def stored() -> bool:
            try:
                await self._library.put_async(
                    self._store,
                    self._path(key),
                    content,
                    attributes=attributes,
                    mode=mode,
                    use_multipart=not isinstance(content, bytes),
                    chunk_size=PART_BYTES,
                    max_concurrency=2,
                )
            except self._library.exceptions.AlreadyExistsError:
                return False
            return True

        return self._run(stored, key)

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


def _beginning(parts: Iterable[bytes]) -> tuple[bytes, Iterator[bytes]]:
    """Return the first bytes (more than PART_BYTES, or all there are) and the other parts."""
    begin, rest = bytearray(), iter(parts)
    while len(begin) <= PART_BYTES and (part := next(rest, None)) is not None:
        begin += part
    return bytes(begin), rest


def _client(*, allow_http: bool) -> ClientConfig:
    return {
        "allow_http": allow_http,
        "connect_timeout": timedelta(seconds=5),
        # The longest wait for a next byte: on a slow line, a large part may take much longer.
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


# Ctrl-C cannot interrupt a blocking call of the library, only the wait for this thread. A request
# that still runs when Python exits would make the library print a Rust backtrace.
class RequestLoop:
    """An asyncio loop in a separate thread; call `end` before Python exits."""

    def __init__(
        self,
        now_s: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._now_s = now_s
        self._sleep = sleep
        self._cancelled_s = -inf
        """The time of the last cancellation of a request."""

        self.loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self.loop.run_forever, name="store", daemon=True)
        self._thread.start()

    def start(self, request: Coroutine[Any, Any, _Result]) -> Future[_Result]:
        """Start a request, and return the future of its result."""
        return asyncio.run_coroutine_threadsafe(request, self.loop)

    def run(self, request: Coroutine[Any, Any, _Result]) -> _Result:
        """Run a request and return its result; cancel the request on Ctrl-C."""
        started = self.start(request)
        try:
            return started.result()
        except BaseException:
            if started.cancel():
                self._cancelled_s = self._now_s()
            raise

    def end(self) -> None:
        """Cancel all requests, end the thread, and give the library time to end its threads."""

        def cancel_all() -> None:
            for task in asyncio.all_tasks(self.loop):
                task.cancel()
                self._cancelled_s = self._now_s()
            self.loop.call_soon(self.loop.stop)

        self.loop.call_soon_threadsafe(cancel_all)
        self._thread.join()
        self.loop.close()
        left_s = self._cancelled_s + _LIBRARY_LETS_GO_S - self._now_s()
        if left_s > 0.0:
            self._sleep(left_s)


@cache
def requests() -> RequestLoop:
    """Return the loop for all requests of this process."""
    loop = RequestLoop()
    atexit.register(loop.end)
    return loop


# The library's error texts may contain signatures and headers: ours must not.
def error_of(error: Exception, scheme: str, where: str) -> StoreError:
    """Return the StoreError for an `error` of the library; `where` names the object or store."""
    text = str(error)
    kind = type(error).__name__
    cure = _CREDENTIALS.get(scheme, _OF_THE_SERVER)
    if "NoSuchBucket" in text or "ContainerNotFound" in text:
        return NoSuchObject(f"{where}: there is no such bucket", "check the URL")
    if kind in ("FileNotFoundError", "NotFoundError"):
        return NoSuchObject(f"{where} does not exist")
    if kind in ("PreconditionError", "NotModifiedError"):
        return changed(where)
    if _INSTANCE_METADATA.search(text):
        return AccessDenied(f"{where}: there are no credentials", cure)
    if kind in ("PermissionDeniedError", "UnauthenticatedError") or _status(text) in (401, 403):
        return AccessDenied(f"{where}: access is denied{_code(text)}", cure)
    if kind == "InvalidPathError":
        found = re.search(r'[Pp]ath "([^"]*)"', text)
        name = short_name(found[1]) if found else ""
        cure = "rename or remove it, or give a folder that it is not in"
        return StoreFailed(f"{where}: an object '{name}' there has an impossible name", cure)
    return _failure(text, scheme, where)


def _failure(text: str, scheme: str, where: str) -> StoreFailed:
    status = _status(text)
    if "without LOCATION" in text or status in (301, 307, 308):
        cure = "set AWS_REGION to the region of the bucket" if scheme == "s3" else "check the URL"
        return StoreFailed(f"{where}: the store sends requests elsewhere", cure)
    if status is not None:
        return StoreFailed(f"{where}: the store answers with HTTP status {status}{_code(text)}")
    if "BadScheme" in text:
        return StoreFailed(f"{where}: the connection would not be encrypted", ALLOW_HTTP)
    if _BROKEN.search(text):
        return BrokenAnswer(f"{where}: the store broke off in the middle of an answer")
    reasons = (reason for word, reason in _REASONS.items() if word in text)
    reason = next(reasons, "the request failed")
    return StoreFailed(f"{where}: {reason}", "check the network and the URL")


def _status(text: str) -> int | None:
    found = re.search(r"status(?: code)?: (\d{3})\b", text)
    return int(found[1]) if found else None


def _code(text: str) -> str:
    """Return the error code of the store in parentheses, such as ` (SlowDown)`, or ""."""
    found = re.search(r"<Code>(\w{1,60})</Code>", text)
    return f" ({found[1]})" if found else ""


def profile_keys(environment: Mapping[str, str]) -> S3Config:
    """Return keys and region of the AWS profile that AWS_PROFILE names, or of the default profile.

    The result is empty if `environment` already names credentials, or the profile has no keys.
    """
    if _OTHER_SOURCES & environment.keys():
        return {}
    profile = environment.get("AWS_PROFILE", _DEFAULT)
    in_config = profile if profile == _DEFAULT else f"profile {profile}"
    told = _section(environment.get("AWS_CONFIG_FILE", "~/.aws/config"), in_config)
    told |= _section(environment.get("AWS_SHARED_CREDENTIALS_FILE", "~/.aws/credentials"), profile)
    if not {"aws_access_key_id", "aws_secret_access_key"} <= told.keys():
        return {}
    found: S3Config = {
        "access_key_id": told["aws_access_key_id"],
        "secret_access_key": told["aws_secret_access_key"],
    }
    if "aws_session_token" in told:
        found["session_token"] = told["aws_session_token"]
    if "region" in told and not {"AWS_REGION", "AWS_DEFAULT_REGION"} & environment.keys():
        found["region"] = told["region"]
    return found


def _section(file: str, name: str) -> dict[str, str]:
    """Return the values in a section, empty if it cannot be read."""
    parser = ConfigParser(interpolation=None, default_section="")
    try:
        parser.read_string(Path(file).expanduser().read_text(encoding="utf-8"))
        return dict(parser[name])
    except (OSError, ValueError, KeyError, RuntimeError, Error):
        return {}
