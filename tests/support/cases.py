"""Many quick cases in one test: each test of its own costs pytest some milliseconds."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable
from typing import Any

Test = Callable[..., None]


def for_each(names: str | tuple[str, ...], cases: Iterable[Any]) -> Callable[[Test], Test]:
    """Call a test with each case, as `pytest.mark.parametrize` does, but as one test.

    An error names the case. For tests without fixtures: a fixture would be the same for all cases.
    """
    keys = (names,) if isinstance(names, str) else names
    listed = list(cases)

    def decorate(test: Test) -> Test:
        @functools.wraps(test)
        def run(**others: Any) -> None:
            for case in listed:
                values = dict(zip(keys, (case,) if len(keys) == 1 else case, strict=True))
                try:
                    test(**others, **values)
                except BaseException as error:
                    error.add_note(f"with {values}")
                    raise

        signature = inspect.signature(test)
        left = [each for name, each in signature.parameters.items() if name not in keys]
        run.__signature__ = signature.replace(parameters=left)  # type: ignore[attr-defined]
        return run

    return decorate
