"""The signing keys of a robot, and the sealed files known to this machine.

The key of each file signs the key of the next file, and is then overwritten: a thief of the present
key cannot sign older files. The journal of decisions lists all sealed files.
"""

from __future__ import annotations

import json
import os
import secrets
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Self

from robotctl.base.errors import RobotctlError
from robotctl.base.files import open_regular
from robotctl.base.paths import make_private, state_folder
from robotctl.decisions.journal import (
    ABOUT_SEALS,
    FOLDER,
    MAX_KEPT_BYTES,
    DecisionKind,
    Entry,
    OpenedLine,
    append,
    digests,
    entries_in,
    files_of,
    kept_file,
    last_file,
    locked,
)
from robotctl.recording.format.disk import open_private
from robotctl.recording.format.seal_records import NO_DIGEST, Link, Opening, SealOfFile

SEED_BYTES: Final = 32


class SigningKey:
    """An Ed25519 private key."""

    def __init__(self, seed: bytes) -> None:
        """Derive the key from `seed`, 32 random bytes."""
        from nacl.bindings import crypto_sign_seed_keypair

        public, self._secret = crypto_sign_seed_keypair(seed)
        self.public: str = public.hex()
        """The public key in hex."""

    def sign(self, data: bytes) -> bytes:
        """Return the signature of `data`, 64 bytes."""
        from nacl.bindings import crypto_sign, crypto_sign_BYTES

        signed: bytes = crypto_sign(data, self._secret)
        return signed[:crypto_sign_BYTES]


def is_signed(data: bytes, signature: bytes, public: str) -> bool:
    """Return whether the holder of the private key of `public` (in hex) signed `data`."""
    from nacl.bindings import crypto_sign_open
    from nacl.exceptions import BadSignatureError

    try:
        crypto_sign_open(signature + data, bytes.fromhex(public))
    except (BadSignatureError, ValueError):
        return False
    return True


def signed_journal(opening: Opening, digests: Sequence[str]) -> bytes:
    """Return what a file's key signs: its certificate, and the digests of the decisions before."""
    return f"robotctl seal: journal\0{opening.certificate} {' '.join(digests)}".encode()


KEY_FILE: Final = "key.json"
_MAX_KEY_BYTES = 1 << 16


@dataclass(frozen=True, slots=True)
class Head:
    """The newest signed link of a robot, which its next file continues. `file` is "" if none."""

    file: str = ""
    number: int = 0
    covered: int = 0
    time_ns: int = 0
    digest: str = NO_DIGEST.hex()
    closed: bool = False


@dataclass(frozen=True, slots=True)
class StoredKey:
    """The content of `key.json`, with keys in hex.

    `seed` is the private key, `root` the chain's first public key, `files` the number of files.
    """

    root: str
    key: str
    seed: str
    files: int
    head: Head

    @classmethod
    def new(cls) -> Self:
        """Return a new key that begins a chain of files."""
        seed = secrets.token_bytes(SEED_BYTES)
        public = SigningKey(seed).public
        return cls(public, public, seed.hex(), 0, Head())


class Keyring:
    """The keys of one robot, created when first needed.

    All methods but `load` raise RobotctlError if a folder is not trusted or cannot be created.
    """

    def __init__(self, folder: Path, robot: str, on_head: Callable[[Head], None] = lambda _: None):
        """Keep `key.json` in `folder`. `on_head` gets each head after `keep` has stored it."""
        self._folder = folder
        self._journal = folder.with_name(FOLDER)
        self._robot = robot
        self._on_head = on_head

    def load(self) -> StoredKey | None:
        """Return the present key, or None if the robot has no key yet.

        Raises:
            OSError: `key.json` cannot be read.
            ValueError: `key.json` is damaged.
        """
        try:
            with open_regular(self._folder / KEY_FILE) as stream:
                values: dict[str, Any] = json.loads(stream.read(_MAX_KEY_BYTES))
            stored = StoredKey(**values | {"head": Head(**values["head"])})
            bytes.fromhex(stored.head.digest)
            if SigningKey(bytes.fromhex(stored.seed)).public != stored.key:
                raise ValueError("private and public key do not fit")
        except FileNotFoundError:
            return None
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            raise ValueError(f"{self._folder / KEY_FILE} is damaged: {error}") from error
        return stored

    def open_file(self, file: str) -> SealOfFile:
        """Return the seal of a new file. Its key replaces the stored key.

        Raises:
            OSError, ValueError: The keys cannot be read or written.
        """
        with self._locked():
            stored = self._load_or_make()
            seed = secrets.token_bytes(SEED_BYTES)
            key = SigningKey(seed)
            opening = Opening(
                robot=self._robot,
                root=stored.root,
                number=stored.files + 1,
                file=file,
                time_ns=time.time_ns(),
                previous_file=stored.head.file,
                previous=stored.head.digest,
                previous_key=stored.key,
                key=key.public,
            )
            before = SigningKey(bytes.fromhex(stored.seed))
            opening = replace(opening, certificate=before.sign(opening.signed()).hex())
            last_file(self._journal)  # this ends a torn last line, before the digest
            found = digests(self._journal)
            signature = key.sign(signed_journal(opening, found)).hex()
            self._note(DecisionKind.OPENED, asdict(opening), journal=found, signature=signature)
            self._save(replace(stored, key=key.public, seed=seed.hex(), files=opening.number))
        return SealOfFile(opening, key.sign)

    def keep(self, opening: Opening, link: Link, *, closed: bool) -> None:
        """Store `link`, the newest one of a file. The seal of the next file continues it.

        Raises:
            OSError, ValueError: The link cannot be stored, or another recorder opened a later file.
        """
        head = Head(
            opening.file, opening.number, link.covered, link.time_ns, link.digest.hex(), closed
        )
        with self._locked():
            stored = self.load()
            if stored is None:
                raise ValueError(f"{self._folder / KEY_FILE} was removed")
            if stored.files != opening.number:
                raise ValueError("another recorder has taken over the chain of this robot")
            self._save(replace(stored, head=head))
            if closed:
                self._note(DecisionKind.CLOSED, asdict(head) | {"key": opening.key})
        self._on_head(head)

    def rotate(self) -> StoredKey:
        """Begin a new chain, and return its first key, which the present key signs.

        Raises:
            OSError, ValueError: The present key cannot be read, or the new key cannot be written.
        """
        with self._locked():
            stored = self._load_or_make()
            new = StoredKey.new()
            text = f"robotctl seal: rotated\0{stored.root} {new.root}".encode()
            signature = SigningKey(bytes.fromhex(stored.seed)).sign(text)
            rotated = {"from": stored.root, "by": stored.key, "to": new.root}
            self._note(DecisionKind.ROTATED, rotated | {"certificate": signature.hex()})
            self._save(replace(new, files=stored.files))
        return new

    def _load_or_make(self) -> StoredKey:
        stored = self.load()
        if stored is None:
            stored = StoredKey.new()
            self._save(stored)
        return stored

    def _save(self, stored: StoredKey) -> None:
        """Replace `key.json`, and overwrite the bytes of the old file with zeros."""
        path, unfinished = self._folder / KEY_FILE, self._folder / f"{KEY_FILE}.new"
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW
        with open(open_private(unfinished, flags), "w", encoding="ascii") as stream:
            json.dump(asdict(stored), stream)
            stream.flush()
            os.fsync(stream.fileno())
        try:
            old = os.open(path, os.O_WRONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
        except FileNotFoundError:
            unfinished.replace(path)
            return
        try:
            unfinished.replace(path)
            os.pwrite(old, bytes(os.fstat(old).st_size), 0)
            os.fsync(old)
        finally:
            os.close(old)

    def _note(self, kind: DecisionKind, values: dict[str, Any], **proof: Any) -> None:
        append(last_file(self._journal), [Entry(time.time_ns(), kind, {kind: values, **proof})])

    @contextmanager
    def _locked(self) -> Iterator[None]:
        """Lock keys and journal during the block. An OLD_LIST is first moved into the journal."""
        make_private(self._folder)
        old = self._folder / OLD_LIST
        with locked(self._journal):
            with suppress(OSError):  # the list stays, and is read where it is
                if old.exists():
                    append(kept_file(self._journal), entries_of_list(old))
                    old.replace(old.with_name(f"{OLD_LIST}.old"))  # a kill before doubles lines
            yield


OLD_LIST: Final = "heads.jsonl"
"""The list of opened and closed files of early versions, in the folder of the keys."""


def entries_of_list(path: Path) -> Iterator[Entry]:
    """Yield the valid lines of `path`, a list by an early version, as entries of the journal.

    Raises:
        OSError: The list does not exist, or cannot be read.
    """
    with open_regular(path) as stream:
        for line in stream.read(MAX_KEPT_BYTES).splitlines():
            with suppress(ValueError, AttributeError, RecursionError):
                for kind, values in json.loads(line).items():
                    if kind in ABOUT_SEALS:
                        yield Entry(0, kind, {kind: values})


@dataclass(slots=True)
class KnownHeads:
    """The sealed files of all robots that this machine knows.

    `opened` and `closed` map a file's public key to its opening and last link. `signed` names the
    files with a signed link. `keys` has public keys by name: a clock set back can repeat a name.
    """

    opened: dict[str, Opening] = field(default_factory=dict)
    closed: dict[str, Head] = field(default_factory=dict)
    signed: set[str] = field(default_factory=set)
    keys: dict[str, set[str]] = field(default_factory=dict)

    def add(self, entry: Entry) -> None:
        """Add what a journal entry tells of a sealed file, if its kind is OPENED or CLOSED.

        Raises:
            ValueError, TypeError, KeyError: The entry is malformed.
        """
        if entry.kind == DecisionKind.OPENED:
            opening = _opening(entry)
            self.opened[opening.key] = opening
            self.keys.setdefault(opening.file, set()).add(opening.key)
            if opening.previous_file:  # this file continues a signed link of that one
                self.signed.add(opening.previous_file)
        elif entry.kind == DecisionKind.CLOSED:
            values = dict(entry.values[entry.kind])
            key = str(values.pop("key"))
            self.closed[key] = Head(**values)
            self.signed.add(self.closed[key].file)

    def named(self, root: str, number: int) -> str:
        """Return the name of file `number` in the chain with first key `root`, "" if unknown."""
        found = (
            opening.file
            for opening in self.opened.values()
            if (opening.root, opening.number) == (root, number)
        )
        return next(found, "")


def _opening(entry: Entry) -> Opening:
    return Opening.read(json.dumps(entry.values[entry.kind]).encode())


def known_heads() -> KnownHeads:
    """Return the sealed files that the readable journals of this user's robots list."""
    heads = KnownHeads()
    with suppress(RobotctlError, OSError):
        for robot in state_folder().iterdir():
            journal = robot / FOLDER
            paths = kept_file(journal), *files_of(journal)
            for entries in (
                entries_of_list(robot / "seal" / OLD_LIST),
                *(entries_in(path, DecisionKind.OPENED, DecisionKind.CLOSED) for path in paths),
            ):
                with suppress(OSError):
                    for entry in entries:
                        with suppress(ValueError, TypeError, KeyError):
                            heads.add(entry)
    return heads


def wrong_openings(lines: Iterable[OpenedLine]) -> Iterator[str]:
    """Yield a sentence for each `opened` line whose signature contradicts the journal before it."""
    for line in lines:
        proved = False
        with suppress(ValueError, TypeError, KeyError):
            opening, told = _opening(line.entry), line.entry.values["journal"]
            signature = bytes.fromhex(line.entry.values["signature"])
            proved = is_signed(signed_journal(opening, told), signature, opening.key) and all(
                found in (digest, "") for digest, found in zip(told, line.before, strict=True)
            )
        if not proved:
            yield (
                f"{line.place} does not sign the lines before it: "
                "something was changed, removed or added"
            )
