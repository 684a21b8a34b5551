"""What was accepted although the gate names it: by whom, when and why."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from robotctl.errors import ConfigError, Refused
from robotctl.fleet.judgement import Judgement
from robotctl.fleet.typed import Typed
from robotctl.regular_file import open_regular

MAX_BYTES: Final = 64 << 20

FORMAT: Final = 2
"""A file without this number accepted more than a person had seen."""


@dataclass(frozen=True, slots=True)
class Accepted:
    """One accepted result: of the recording with this hash, this outcome with these settings.

    `outcome` is the hash over all that is wrong or changed; `verdict` and `says` are for people.
    """

    name: str
    recording: str
    settings: dict[str, str]
    outcome: str
    verdict: str
    says: str
    by: str
    why: str
    at: str
    """When, as ISO 8601."""


@dataclass(frozen=True, slots=True)
class _File:
    format: int
    accepted: tuple[Accepted, ...]


_file = Typed(_File)

_Key = tuple[str, tuple[tuple[str, str], ...], str]


class Baseline:
    """The accepted results of a file: another content, setting or outcome is not accepted."""

    def __init__(self, accepted: Iterable[Accepted] = ()) -> None:
        self._accepted = {
            _key(each.recording, each.settings, each.outcome): each for each in accepted
        }

    def find(self, result: Judgement) -> Accepted | None:
        """Return who accepted this result, None if it is not accepted."""
        return self._accepted.get(_key(result.recording, result.settings, result.outcome))

    def accept(self, name: str, result: Judgement, *, by: str, why: str, at: str) -> None:
        """Accept a result."""
        recording, settings, outcome = result.recording, result.settings, result.outcome
        says = result.says or "other parameters change modes or answers"
        self._accepted[_key(recording, settings, outcome)] = Accepted(
            name, recording, settings, outcome, result.verdict, says, by, why, at
        )

    def write(self, path: Path) -> None:
        """Write the file, completely or not at all.

        Raises:
            Refused: It cannot be written.
        """
        accepted = sorted(self._accepted.values(), key=lambda each: (each.name, each.says))
        file = {"format": FORMAT, "accepted": [asdict(each) for each in accepted]}
        beside = path.with_name(f".{path.name}.{os.getpid()}")
        try:
            with beside.open("x", encoding="utf-8") as opened:
                opened.write(json.dumps(file, indent=2) + "\n")
            beside.replace(path)
        except OSError as error:
            beside.unlink(missing_ok=True)
            raise Refused(f"cannot write {path}: {error.strerror or error}") from error


def read_baseline(path: Path) -> Baseline:
    """Return the baseline in a file, an empty one if there is no file.

    Raises:
        ConfigError: It is not a baseline, or one of an older robotctl.
    """
    try:
        with open_regular(path) as opened:
            found = json.loads(opened.read(MAX_BYTES))
        if isinstance(found, dict) and "accepted" in found and "format" not in found:
            raise ConfigError(
                f"{path} is not a baseline of this gate: an older robotctl wrote it, which "
                f"accepted other parameters and other numbers, too",
                "name a new file, and accept again what is still right",
            )
        file = _file(found)
        if file.format != FORMAT:
            raise ValueError(f"it has the format {file.format}, this robotctl knows {FORMAT}")
    except FileNotFoundError:
        return Baseline()
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(f"{path} is not a baseline of the gate: {error}") from None
    return Baseline(file.accepted)


def _key(recording: str, settings: Mapping[str, str], outcome: str) -> _Key:
    return recording, tuple(sorted(settings.items())), outcome
