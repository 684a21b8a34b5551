"""What was accepted although the gate names it: by whom, when and why."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from robotctl.errors import ConfigError, Refused
from robotctl.fleet.judgement import Judgement
from robotctl.regular_file import open_regular

MAX_BYTES: Final = 64 << 20


@dataclass(frozen=True, slots=True)
class Accepted:
    """One accepted result: of the recording with this hash, this verdict with this cause."""

    name: str
    recording: str
    verdict: str
    cause: str
    by: str
    why: str
    at: str
    """When, as ISO 8601."""


class Baseline:
    """The accepted results of a file; another content of the recording or cause is not accepted."""

    def __init__(self, accepted: Iterable[Accepted] = ()) -> None:
        self._accepted = {(each.recording, each.verdict, each.cause): each for each in accepted}

    def find(self, result: Judgement) -> Accepted | None:
        """Return who accepted this result, None if it is not accepted."""
        return self._accepted.get((result.recording, result.verdict, result.cause))

    def accept(self, name: str, result: Judgement, *, by: str, why: str, at: str) -> None:
        """Accept a result."""
        key = result.recording, result.verdict, result.cause
        self._accepted[key] = Accepted(name, *key, by, why, at)

    def write(self, path: Path) -> None:
        """Write the file, completely or not at all.

        Raises:
            Refused: It cannot be written.
        """
        accepted = sorted(self._accepted.values(), key=lambda each: (each.name, each.cause))
        text = json.dumps({"accepted": [asdict(each) for each in accepted]}, indent=2) + "\n"
        beside = path.with_name(f".{path.name}.{os.getpid()}")
        try:
            with beside.open("x", encoding="utf-8") as file:
                file.write(text)
            beside.replace(path)
        except OSError as error:
            beside.unlink(missing_ok=True)
            raise Refused(f"cannot write {path}: {error.strerror or error}") from error


def read_baseline(path: Path) -> Baseline:
    """Return the baseline in a file, an empty one if there is no file.

    Raises:
        ConfigError: It is not a baseline.
    """
    try:
        with open_regular(path) as file:
            found: Any = json.loads(file.read(MAX_BYTES))
        return Baseline(Accepted(**each) for each in found["accepted"])
    except FileNotFoundError:
        return Baseline()
    except (OSError, ValueError, TypeError, KeyError, RecursionError) as error:
        raise ConfigError(f"{path} is not a baseline of the gate: {error}") from None
