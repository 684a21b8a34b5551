"""What can go wrong with a store, as sentences without credentials."""

from __future__ import annotations

from robotctl.errors import UnreadableFile


class StoreError(UnreadableFile):
    """A store that does not do what it is asked for; the base class of the errors below."""


class NoSuchObject(StoreError):
    """An object, a bucket or a folder that does not exist."""


class AccessDenied(StoreError):
    """A store that wants other credentials, or none that is there."""


class TooLarge(StoreError):
    """An object with more bytes than the reader takes."""


class ObjectChanged(StoreError):
    """An object that changed since it was first read."""


class StoreFailed(StoreError):
    """A store that cannot be reached, or answers with an error, also after several tries."""


class BrokenAnswer(StoreFailed):
    """An answer that ended early."""
