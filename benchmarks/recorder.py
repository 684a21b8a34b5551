"""The recorder: CPU, loop lag, loss, footer and memory, against others and bare receiving.

    python benchmarks/recorder.py                              everything but the slow part
    python benchmarks/recorder.py --quick                      one short round
    python benchmarks/recorder.py --parts lag,rate --rounds 9
    python benchmarks/recorder.py --parts soak                 10 minutes, alone

Each round measures every part, and each part every contender, so that a noisy machine is noisy for
all; ratios and differences are computed within a round. Shown are medians over the rounds, and the
lowest and highest in brackets. CPU is that of the whole process, including the threads of the
middleware. A separate process publishes the load, in C++ where there is a compiler. Needs the `dev`
extra (foxglove-sdk).
"""

from __future__ import annotations

import argparse
import signal
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from recording import footer, live, memory, publisher, writers
from recording.figures import Figure, Round, table
from recording.live import Bench

from robotctl.base.domains import reserved_domain


@dataclass(frozen=True)
class Part:
    """Figures that are measured together."""

    figures: Callable[[], Iterable[Figure]]
    measure: Callable[[Bench], Iterator[tuple[str, float]]]


PARTS = {
    "writers": Part(writers.figures, lambda bench: writers.measure(bench.scratch)),
    "footer": Part(footer.figures, lambda bench: footer.measure(bench.scratch)),
    "end-to-end": Part(live.end_to_end_figures, live.end_to_end),
    "added": Part(live.added_figures, live.added),
    "lag": Part(live.lag_figures, live.lag),
    "rate": Part(live.rate_figures, live.rate),
    "images": Part(live.images_figures, live.images),
    "memory": Part(memory.figures, memory.measure),
}
SLOW_PARTS = {"soak": Part(memory.soak_figures, memory.soak)}


def main() -> int:
    arguments = parse()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("told to end"))  # and end what was started
    parts = {name: {**PARTS, **SLOW_PARTS}[name] for name in arguments.parts}
    results: dict[str, list[Round]] = {name: [] for name in parts}
    with tempfile.TemporaryDirectory(dir=arguments.scratch) as scratch, reserved_domain() as domain:
        library = publisher.build(Path(scratch))
        if not library:
            print("no C++ compiler: the load comes from Python and is slower", file=sys.stderr)
        bench = Bench(library, arguments.seconds, Path(scratch), domain)
        for number in range(1, arguments.rounds + 1):
            for name, part in parts.items():
                print(f"round {number} of {arguments.rounds}: {name}", file=sys.stderr)
                results[name].append(dict(part.measure(bench)))
    missed = 0
    print("| figure | to reach | measured | |\n|---|---|---|---|")
    for name, part in parts.items():
        lines, count = table(part.figures(), results[name])
        missed += count
        print(*lines, sep="\n")
    print(f"\n{missed} missed." if missed else "\nAll reached.")
    return 1 if missed else 0


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--parts", default=",".join(PARTS), help="which, by name, with commas")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=4.0, help="of one measurement")
    parser.add_argument("--quick", action="store_true", help="1 round of 1 second")
    parser.add_argument("--scratch", type=Path, help="a folder on the disk to use")
    arguments = parser.parse_args()
    arguments.parts = arguments.parts.split(",")
    known = [*PARTS, *SLOW_PARTS]
    if unknown := set(arguments.parts) - set(known):
        parser.error(f"unknown parts {sorted(unknown)}; there are {', '.join(known)}")
    if arguments.quick:
        arguments.rounds, arguments.seconds = 1, 1.0
    return arguments


if __name__ == "__main__":
    sys.exit(main())
