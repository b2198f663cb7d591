# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Runs cases of damage in a process with bounded memory and time.

    python test/faults/fuzz.py KIND [--seconds S | --cases N] [--first SEED]

A line of JSON for each case: kind, seed, what was done to what, and what came of it.
`make fuzz` runs all kinds for an hour. A case is run again by its seed:
``--first SEED --cases 1``.
"""

from __future__ import annotations

import argparse
import importlib
import json
import resource
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, Protocol

sys.path.insert(0, str(Path(__file__).parent))

# Numbers of cases that `make test` runs of each kind, within seconds.
KINDS = {"bags": 250, "replays": 40, "images": 600, "documents": 400, "commands": 250}
# Nothing that these cases read takes as much; beyond the second limit the system refuses.
MOST_MEMORY, HARD_LIMIT = 1 << 30, 6 << 30
LONGEST = 30.0


class Outcome(NamedTuple):
    """What came of a case.

    Attributes
    ----------
    case : str
        What was done to what.
    verdict : str
        "read", "refused" or "partly", which are well; anything else is not.
    detail : str
    """

    case: str
    verdict: str
    detail: str = ""


WELL = ("read", "refused", "partly")


class Kind(Protocol):
    """A kind of cases: something to damage, and to be read."""

    def __init__(self, folder: Path) -> None: ...

    def run(self, seed: int) -> Outcome:
        """Run a case."""
        ...


class TooSlowError(BaseException):
    """A case takes longer than any should."""


def run(kind: str, seeds: Iterator[int], seconds: float) -> Iterator[dict[str, Any]]:
    """Run cases until there are no more, or the time is up."""

    def stop(*_: object) -> None:
        raise TooSlowError

    signal.signal(signal.SIGALRM, stop)
    end = time.monotonic() + seconds
    with tempfile.TemporaryDirectory(prefix="uw_visibility_fuzz_") as folder:
        cases: Kind = importlib.import_module(f"fuzz_{kind}").Cases(Path(folder))
        for seed in seeds:
            begin = time.monotonic()
            if begin > end:
                return
            signal.setitimer(signal.ITIMER_REAL, LONGEST)
            try:
                outcome = cases.run(seed)
            except TooSlowError:
                outcome = Outcome("", "too slow", traceback.format_exc(limit=-4))
            except BaseException as error:
                detail = "".join(traceback.format_exception(error)[-6:])
                outcome = Outcome("", "internal", detail)
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10
            if memory > MOST_MEMORY:
                outcome = outcome._replace(verdict=f"{memory >> 20} MiB")
            yield {
                "kind": kind, "seed": seed, **outcome._asdict(),
                "seconds": round(time.monotonic() - begin, 3),
            }
            if memory > MOST_MEMORY:
                return


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kinds", nargs="*", choices=[*KINDS, []], help="all")
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--cases", type=int)
    parser.add_argument("--first", type=int, default=0)
    arguments = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_AS, (HARD_LIMIT, HARD_LIMIT))
    kinds = arguments.kinds or list(KINDS)
    bad = 0
    for kind in kinds:
        count = arguments.cases
        if count is None and arguments.seconds == float("inf"):
            count = KINDS[kind]
        last = sys.maxsize if count is None else arguments.first + count
        seeds = iter(range(arguments.first, last))
        for line in run(kind, seeds, arguments.seconds / len(kinds)):
            bad += line["verdict"] not in WELL
            print(json.dumps(line), flush=True)
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
