# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Runs cases of damage in a process with bounded memory and time.

    python test/faults/fuzz.py [KIND...] [--minutes M | --cases N] [--first SEED] [--together]

A line of JSON for each case: kind, seed, what was done to what, and what came of it.
`make fuzz` runs all kinds for an hour and tells the bad cases alone. A case is run again
by its seed: ``KIND --first SEED --cases 1``.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, chdir
from pathlib import Path
from typing import Any, NamedTuple, Protocol

sys.path.insert(0, str(Path(__file__).parent))

# Numbers of cases that `make studies` runs of each kind, within seconds.
KINDS = {
    "bags": 200, "replays": 12, "resumes": 12, "images": 500, "documents": 300, "commands": 100,
    "pictures": 30, "messages": 20, "pairs": 8, "parameters": 8, "signals": 2,
}
# Those that need ROS.
WITH_NODES = ("messages", "pairs", "parameters", "signals")
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
    """A kind of cases: something to damage, and to be read.

    Attributes
    ----------
    case : str
        What was done to what, last.
    """

    case: str

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
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="uw_visibility_fuzz_"))
        cases: Kind = importlib.import_module(f"fuzz_{kind}").Cases(Path(folder))
        # A command may write to the current folder, as by -o "".
        stack.enter_context(chdir(folder))
        # Nodes must end well.
        stack.callback(getattr(cases, "close", lambda: None))
        for seed in seeds:
            begin = time.monotonic()
            if begin > end:
                return
            signal.setitimer(signal.ITIMER_REAL, LONGEST)
            try:
                outcome = cases.run(seed)
            except TooSlowError:
                outcome = Outcome(cases.case, "too slow", traceback.format_exc(limit=-4))
            except BaseException as error:
                detail = "".join(traceback.format_exception(error)[-6:])
                outcome = Outcome(cases.case, "internal", detail)
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
    parser.add_argument("kinds", nargs="*", help=f"of {', '.join(KINDS)} (default: all)")
    parser.add_argument("--minutes", type=float, help="go on for so long, and tell the bad cases")
    parser.add_argument("--cases", type=int, help="cases of each kind")
    parser.add_argument("--first", type=int, default=0, help="seed of the first case")
    parser.add_argument(
        "--together", action="store_true", help="all kinds in this process, which starts once")
    arguments = parser.parse_args()
    kinds = arguments.kinds or [
        kind for kind in KINDS if kind not in WITH_NODES or importlib.util.find_spec("rclpy")
    ]
    if len(kinds) == 1 or arguments.together:
        return max(run_kind(kind, arguments) for kind in kinds)
    # Each in a process of its own, so that its memory is its own too.
    options = ["--first", str(arguments.first)]
    if arguments.cases is not None:
        options += ["--cases", str(arguments.cases)]
    if arguments.minutes is not None:
        options += ["--minutes", str(arguments.minutes / len(kinds))]
    codes = [
        subprocess.run([sys.executable, __file__, kind, *options], check=False).returncode
        for kind in kinds
    ]
    return int(any(codes))


def run_kind(kind: str, arguments: argparse.Namespace) -> int:
    """Run cases of a kind and print what came of them."""
    resource.setrlimit(resource.RLIMIT_AS, (HARD_LIMIT, HARD_LIMIT))
    count, seconds = arguments.cases or KINDS[kind], float("inf")
    if arguments.minutes is not None:
        count, seconds = sys.maxsize, 60.0 * arguments.minutes
        # What libraries say of damaged data would hide what is told here.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    verdicts: Counter[str] = Counter()
    first = arguments.first
    try:
        for line in run(kind, iter(range(first, first + count)), seconds):
            verdicts[line["verdict"]] += 1
            if arguments.minutes is None or line["verdict"] not in WELL:
                print(json.dumps(line), flush=True)
    except Exception as error:
        print(f"{kind}: no cases could be run after {verdicts.total()}: {error!r}", flush=True)
        raise
    if arguments.minutes is not None:
        print(f"{kind}: {verdicts.total()} cases from seed {first} on, {dict(verdicts)}")
    return int(any(verdict not in WELL for verdict in verdicts))


if __name__ == "__main__":
    sys.exit(main())
