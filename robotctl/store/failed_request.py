"""What an error of obstore means for the user. Its own text may show signatures and headers."""

from __future__ import annotations

import re
from typing import Final

from robotctl.printable import short_name
from robotctl.store.store_errors import (
    AccessDenied,
    BrokenAnswer,
    NoSuchObject,
    ObjectChanged,
    StoreError,
    StoreFailed,
)

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
"""Words of the error, and what they mean; the first that is found counts."""

_INSTANCE_METADATA: Final = re.compile(
    r"169\.254\.169\.254|metadata\.google|metadata\.azure|SharedKeyCredential|MissingKey"
)


def error_of(error: Exception, scheme: str, where: str) -> StoreError:
    """Return the error for the user; `where` names the object, or the store."""
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


def changed(where: str) -> ObjectChanged:
    """Return the error for an object that has another content than before."""
    return ObjectChanged(f"{where} was changed while it was read", "run the command again")


def short_answer(where: str, got: int, wanted: int) -> BrokenAnswer:
    """Return the error for an answer of the wrong length [bytes]."""
    return BrokenAnswer(f"{where}: the store sent {got} of {wanted} bytes")


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
    """Return the store's own word for the error, such as ` (SlowDown)`, or ""."""
    found = re.search(r"<Code>(\w{1,60})</Code>", text)
    return f" ({found[1]})" if found else ""
