"""A process that executes commands, one JSON object per line: both ends."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Self

from tests.support.waiting import DEADLINE_S

ROOT = Path(__file__).parents[2]


def peer_command(module: str, *arguments: str) -> list[str]:
    """Return the command that runs `module`, such as `tests.support.ros_peer`, in any folder."""
    run = f"import runpy; runpy.run_module('{module}', run_name='__main__')"
    return [
        sys.executable,
        "-c",
        f"import sys; sys.path.insert(0, {str(ROOT)!r}); {run}",
        *arguments,
    ]


def line_of(pipe: IO[str] | None) -> str:
    """Read the next line of a process that was started with this pipe."""
    assert pipe is not None
    return pipe.readline()


@dataclass(frozen=True, slots=True)
class Ran:
    """The result of a command line."""

    exit_code: int
    out: str
    err: str

    def succeeded(self, *texts: str) -> str:
        """Expect success and these texts on stdout, however its lines are broken; return it."""
        assert (self.exit_code, _missing(self.out, texts)) == (0, []), self
        return self.out

    def failed(self, exit_code: int, *texts: str, out: str = "") -> str:
        """Expect this exit code and these texts on stderr, and one on stdout; return stderr."""
        assert (self.exit_code, _missing(self.err, texts)) == (exit_code, []), self
        assert _missing(self.out, [out]) == [], self
        return self.err

    def refused(self, exit_code: int, *texts: str) -> str:
        """Expect one sentence with these texts and nothing on stdout; return the sentence."""
        assert (self.out, self.err.count("\n")) == ("", 1), self
        return self.failed(exit_code, *texts)

    @property
    def summary(self) -> dict[str, Any]:
        """The object that the command has printed with `--json`."""
        found: dict[str, Any] = json.loads(self.out)
        return found


def run_python(
    program: str, *arguments: object, timeout_s: float = 60.0, **options: Any
) -> subprocess.CompletedProcess[str]:
    """Run a program in a process of its own."""
    command = [sys.executable, "-X", "faulthandler", "-c", program, *map(str, arguments)]
    return subprocess.run(
        command, check=False, capture_output=True, text=True, timeout=timeout_s, **options
    )


def run_program(*command: object, **options: Any) -> Ran:
    """Run a program to its end; `options` are those of subprocess.run."""
    options = {"capture_output": True, "text": True, "timeout": 2 * DEADLINE_S, **options}
    ran = subprocess.run([*map(str, command)], check=False, **options)
    return Ran(ran.returncode, ran.stdout, ran.stderr)


def _missing(stream: str, texts: Iterable[str]) -> list[str]:
    told = f"{stream}\n{' '.join(stream.split())}"
    return [text for text in texts if text not in told]


class Told:
    """The commanding end: starts the process and sends it commands."""

    def __init__(self, command: Sequence[str], environment: Mapping[str, str]) -> None:
        """Start the process and wait until it is ready."""
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
        )
        if self._read() != "ready\n":
            self.close()
            raise AssertionError("the process did not start; its words are above")

    def __call__(self, do: str, **parameters: Any) -> Any:
        """Execute one command and return its result."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps({"do": do, **parameters}) + "\n")
        self._process.stdin.flush()
        line = self._read()
        assert line, f"the process died of {do} {parameters}"
        answer = json.loads(line)
        assert "error" not in answer, answer["error"]
        return answer["result"]

    def __enter__(self) -> Self:
        """End the process with the block."""
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the process by its own shutdown, which leaves no shared memory behind."""
        with self._process:
            try:
                self._process.communicate(timeout=DEADLINE_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                raise

    def _read(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline()


def obey(target: object) -> None:
    """Run in the process: call the methods of `target` that lines of stdin name, print results."""
    print("ready", flush=True)
    for line in sys.stdin:
        request = json.loads(line)
        try:
            answer = {"result": getattr(target, request.pop("do"))(**request)}
        except Exception as error:  # noqa: BLE001 - told to the test
            answer = {"error": repr(error)}
        print(json.dumps(answer), flush=True)
