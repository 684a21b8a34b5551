"""C structures and error texts of rcutils, and the exceptions for failed calls of rcl."""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any


class UnsupportedPlatform(RuntimeError):
    """This platform or middleware cannot announce new data on an eventfd."""


class RclCallFailed(RuntimeError):
    """A call of rcl failed. The text contains rcl's own message."""


class Allocator(ctypes.Structure):
    """The C structure `rcutils_allocator_t`."""

    _fields_ = tuple(
        (name, ctypes.c_void_p)
        for name in ("allocate", "deallocate", "reallocate", "zero_allocate", "state")
    )


class SerializedMessage(ctypes.Structure):
    """The C structure `rcutils_uint8_array_t`."""

    _fields_ = (
        ("buffer", ctypes.c_void_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", Allocator),
    )


class _ErrorString(ctypes.Structure):
    _fields_ = (("text", ctypes.c_char * 1024),)


@cache
def library() -> Any:
    """Return the rcutils library, whose functions keep the GIL."""
    loaded = ctypes.PyDLL("librcutils.so")
    loaded.rcutils_get_default_allocator.restype = Allocator
    loaded.rcutils_get_error_string.restype = _ErrorString
    return loaded


def default_allocator() -> Allocator:
    """Return rcl's default allocator."""
    allocator: Allocator = library().rcutils_get_default_allocator()
    return allocator


def take_error_text() -> str:
    """Return and clear rcl's reason for the last failure in this thread."""
    text: bytes = library().rcutils_get_error_string().text
    library().rcutils_reset_error()
    return text.decode(errors="replace")
