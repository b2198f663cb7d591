# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Command line of `uw_visibility`."""

from __future__ import annotations

import argparse
import sys
import traceback
from collections.abc import Sequence
from typing import NoReturn

from uw_visibility.commands import calibrate, demo, enhance, evaluate, replay, simulate, warmup
from uw_visibility.errors import InputError

DONE, FAILED, UNUSABLE = 0, 1, 2
INTERRUPTED = 130
COMMANDS = (enhance, replay, calibrate, simulate, evaluate, demo, warmup)


class _Parser(argparse.ArgumentParser):
    """Argument parser whose errors are one sentence, like those of all other bad input."""

    def error(self, message: str) -> NoReturn:
        raise InputError(f"{message} (see {self.prog} --help)")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments; those of the process where absent.

    Returns
    -------
    int
        0 when done, 2 for unusable input or options, 1 for a failure inside.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    try:
        arguments = _make_parser().parse_args(_repeat_calibration(words))
        arguments.func(arguments)
    except InputError as error:
        print(f"uw_visibility: {error}", file=sys.stderr)
        return UNUSABLE
    except KeyboardInterrupt:
        print("uw_visibility: interrupted", file=sys.stderr)
        return INTERRUPTED
    except Exception as error:
        if "--debug" in words:
            traceback.print_exc()
        reason = " ".join(str(error).split())
        print(
            f"uw_visibility: internal error, {type(error).__name__}: {reason} "
            "(--debug shows where)",
            file=sys.stderr,
        )
        return FAILED
    return DONE


def _make_parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="uw_visibility",
        description="Underwater visibility, colour and stereo from a stereo camera.",
    )
    subparsers = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for command in COMMANDS:
        command.add_parser(subparsers)
    for subparser in subparsers.choices.values():
        subparser.add_argument(
            "--debug", action="store_true", help="show where an internal error arose"
        )
    return parser


def _repeat_calibration(words: Sequence[str]) -> list[str]:
    """Turn ``--calibration LEFT.yaml RIGHT.yaml`` into two uses of the option.

    argparse knows no option of one or two values: of "one or more" it would
    take the images that follow as well.
    """
    repeated: list[str] = []
    for index, word in enumerate(words):
        pair = index > 1 and words[index - 2] == "--calibration" and all(
            w.lower().endswith((".yaml", ".yml")) for w in (words[index - 1], word)
        )
        repeated += ["--calibration", word] if pair else [word]
    return repeated


if __name__ == "__main__":
    sys.exit(main())
