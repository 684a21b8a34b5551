"""Mutation test of `robotctl/kernel`: how many small changes of the code do its tests notice?

    python tests/mutation/run.py --count 300 --seed 1   300 mutants drawn by the seed
    python tests/mutation/run.py                        every mutant
    python tests/mutation/run.py --part 1/2             every second mutant, for two processors
    python tests/mutation/run.py --only drive.Drive     those of one module, class or function
    python tests/mutation/run.py --again LOG            those that survived a run that printed LOG

cosmic-ray makes the mutants, in a copy of the tree; each one runs `tests/kernel`. A change within a
function is made in a copy of a process that has loaded the tests; any other change is loaded with
the kernel in a new process. A mutant that no test notices has survived: write the test that is
missing, or list the mutant in `equivalent.toml` with the reason why nothing can notice it. The exit
code is 1 when fewer than 95 % of the mutants are killed or more than 3 % are listed as equivalent.
A mutant that never ends is killed by a limit of CPU time; such mutants are named.
"""

from __future__ import annotations

import argparse
import random
import re
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.mutation.kernel_tests import LIMIT_CODE, NewProcesses, copied
from tests.mutation.loaded_tests import LoadedTests, loaded_tests
from tests.mutation.mutants import Key, Site, equivalents, mutant_at, sites, stale_entries

LEAST_KILLED, MOST_EQUIVALENT = 0.95, 0.03


def main() -> int:
    """Draw, run and report."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, help="how many mutants to draw; default: all")
    parser.add_argument("--seed", type=int, default=1, help="of the draw; default: 1")
    parser.add_argument("--part", type=_part, default=slice(None), help="such as 1/2")
    parser.add_argument("--only", default="", help="a name such as drive. or drive.Drive.advance")
    parser.add_argument("--again", type=Path, help="the output of a run: only what survived it")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="robotctl-mutation-") as name:
        folder = copied(Path(name).resolve())
        every, listed = list(sites(folder)), equivalents()
        if stale := stale_entries(listed, every, folder):
            print("equivalent.toml lists what is not in the code:", *stale, sep="\n")
            return 1
        drawn = [site for site in every if site.where.startswith(options.only)]
        if options.again is not None:
            keys = survivors(options.again.read_text())
            near = [site for site in drawn if site.where in {where for where, _, _ in keys}]
            drawn = [site for site in near if mutant_at(site).key in keys]
        print(f"{options.count or 'all'} of {len(drawn)} mutants, seed {options.seed}")
        random.Random(options.seed).shuffle(drawn)
        with loaded_tests(folder) as tests:
            return report(drawn[: options.count][options.part], listed, folder, tests)


def _part(text: str) -> slice:
    """Return which mutants the part `text` has: 3/16 is every 16th from the third on."""
    number, parts = map(int, text.split("/"))
    if not 1 <= number <= parts:
        raise ValueError(text)
    return slice(number - 1, None, parts)


def survivors(log: str) -> set[Key]:
    """Return the mutants that survived, by what `report` has printed."""
    found = re.findall(r"^survived: (.*)\n- ?(.*)\n\+ ?(.*)$", log, re.MULTILINE)
    return {(where, was, now) for where, was, now in found}


def report(
    drawn: Sequence[Site], listed: Mapping[Key, str], folder: Path, tests: LoadedTests
) -> int:
    """Run the mutants, print those that survive and the figures; return the exit code."""
    counts: Counter[str] = Counter()
    wrong = 0
    anew = NewProcesses(folder, tests.cpu_s)
    begin = time.monotonic()
    for number, site in enumerate(drawn, 1):
        mutant = mutant_at(site)
        is_listed = mutant.key in listed
        ran = tests.run(mutant)
        if ran is None:
            counts["of these loaded anew"] += 1
            code = anew.exit_code_with(site.path, mutant.code)
        else:
            code = ran.code
        survived = code == 0
        counts["equivalent" if is_listed else "survived" if survived else "killed"] += 1
        if code == LIMIT_CODE:
            counts["of these by a limit"] += 1
            print(f"ended by a limit: {mutant.where}\n- {mutant.was}\n+ {mutant.now}")
        if is_listed is not survived:
            note = "survived" if survived else "listed as equivalent, but killed"
            print(f"{note}: {mutant.where}\n- {mutant.was}\n+ {mutant.now}")
            wrong += is_listed
        if number % 100 == 0 or number == len(drawn):
            minutes = (time.monotonic() - begin) / 60
            print(f"after {number} mutants, {minutes:.0f} min: {dict(counts)}", flush=True)
    killed, equivalent = (counts[name] / len(drawn) for name in ("killed", "equivalent"))
    print(f"{killed:.1%} killed, {equivalent:.1%} equivalent")
    return int(wrong > 0 or killed < LEAST_KILLED or equivalent > MOST_EQUIVALENT)


if __name__ == "__main__":
    sys.exit(main())
