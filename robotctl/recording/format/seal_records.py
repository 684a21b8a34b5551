"""The records of a seal: a hash chain over the bytes of a recording, and its signatures.

A link has a signature and this digest:

    digest = SHA-256(digest of the previous link + SHA-256(the bytes since that link's offset))

The first link of a file continues a digest of the previous file (`Opening.previous`), or 32 zeros.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from dataclasses import asdict, dataclass
from enum import IntEnum
from hashlib import sha256
from typing import Final, Self

from robotctl.recording.format.records import RECORD_HEAD

OPENING_OPCODE: Final = 0x87
LINK_OPCODE: Final = 0x88

NO_DIGEST: Final = bytes(32)
"""The previous digest of the first file of a chain."""

MAX_OPENING_BYTES: Final = 1 << 16
_FIELDS = struct.Struct("<BIQQ32s")
_SIGNATURE_BYTES: Final = 64

_LINK_DOMAIN = b"robotctl seal: link\0"
_OPENING_DOMAIN = b"robotctl seal: opening\0"


class LinkKind(IntEnum):
    """The purpose of a link in the hash chain."""

    LINK = 1
    """A link in the data, directly behind the covered bytes."""

    HEAD = 2
    """The newest link, in the summary. Each commit overwrites it."""

    REPAIRED = 3
    """An unsigned mark: a repair has written the bytes behind it."""


def chained(before: bytes, hashed: bytes) -> bytes:
    """Return a link's digest, from the previous link's digest and the SHA-256 of the new bytes."""
    return sha256(before + hashed).digest()


@dataclass(frozen=True, slots=True)
class Link:
    """The digest of the first `covered` bytes of a file, and its signature.

    Links of kind LINK are numbered from 1 in each file. A HEAD has the `number` of the next LINK.
    `time_ns` is the time of the signature [ns since the epoch].
    """

    kind: LinkKind
    number: int
    covered: int
    time_ns: int
    digest: bytes
    signature: bytes = bytes(_SIGNATURE_BYTES)

    def signed(self) -> bytes:
        """Return the bytes that the signature of this link covers."""
        return _LINK_DOMAIN + self._fields()

    def record(self) -> bytes:
        """Return the link encoded as an MCAP record."""
        content = self._fields() + self.signature
        return RECORD_HEAD.pack(LINK_OPCODE, len(content)) + content

    @classmethod
    def read(cls, content: bytes) -> Self:
        """Return the link in `content`, the content of a record.

        Raises:
            ValueError: The content is not a link.
        """
        if len(content) != _FIELDS.size + _SIGNATURE_BYTES:
            raise ValueError("a link of the seal has another length")
        kind, number, covered, time_ns, digest = _FIELDS.unpack_from(content)
        return cls(LinkKind(kind), number, covered, time_ns, digest, content[_FIELDS.size :])

    def _fields(self) -> bytes:
        return _FIELDS.pack(self.kind, self.number, self.covered, self.time_ns, self.digest)


@dataclass(frozen=True, slots=True)
class Opening:
    """The record that begins the seal of a file. Keys, digests and signatures are in hex."""

    robot: str
    root: str
    """The first public key of the robot's chain."""

    number: int
    """The number of the file in the chain, from 1."""

    file: str
    time_ns: int
    previous_file: str
    previous: str
    """The newest known digest of `previous_file`."""

    previous_key: str
    """The public key of `previous_file`; for the first file, `root`."""

    key: str
    certificate: str = ""
    """The signature by `previous_key` for all other fields."""

    def signed(self) -> bytes:
        """Return the bytes that `certificate` signs: all other fields."""
        values = asdict(self)
        del values["certificate"]
        return _OPENING_DOMAIN + _json(values)

    def record(self) -> bytes:
        """Return the opening encoded as an MCAP record."""
        content = _json(asdict(self))
        return RECORD_HEAD.pack(OPENING_OPCODE, len(content)) + content

    @classmethod
    def read(cls, content: bytes) -> Self:
        """Return the opening in the content of a record.

        Raises:
            ValueError: The content is not an opening.
        """
        try:
            found = cls(**json.loads(content))
            numbers = found.number, found.time_ns
            if any(type(number) is not int or number < 0 for number in numbers):
                raise ValueError("a number of the seal is none")
            if any(type(text) is not str for text in (found.robot, found.file)):
                raise ValueError("a text of the seal is none")
            keys = found.root, found.previous, found.previous_key, found.key
            if [len(bytes.fromhex(key)) for key in keys] != [32] * 4:
                raise ValueError("a key of the seal has another length")
            if len(bytes.fromhex(found.certificate)) != _SIGNATURE_BYTES:
                raise ValueError("a certificate of the seal has another length")
        except (TypeError, RecursionError) as error:
            raise ValueError("the opening of the seal is malformed") from error
        return found


@dataclass(frozen=True, slots=True)
class SealOfFile:
    """The opening of a file's seal, and a function that signs bytes with the file's key."""

    opening: Opening
    sign: Callable[[bytes], bytes]


def _json(values: dict[str, object]) -> bytes:
    return json.dumps(values, sort_keys=True, separators=(",", ":")).encode()
