# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Command line of `uw_visibility`."""

from __future__ import annotations

import argparse
import functools
import importlib
import io
import os
import signal
import sys
import traceback
from collections.abc import Sequence
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, NoReturn

from uw_visibility import __version__
from uw_visibility.commands import calibrate, enhance, replay, warmup
from uw_visibility.compute.threads import use_one_thread
from uw_visibility.errors import InputError, needing, printable

DONE, FAILED, UNUSABLE = 0, 1, 2
INTERRUPTED, BROKEN_PIPE = 130, 141
COMMANDS = {"enhance": enhance, "replay": replay, "calibrate": calibrate, "warmup": warmup}
# Other distributions add commands by entry points of this group.
GROUP = "uw_visibility.commands"
# Those of the lab, which need not be installed.
OF_THE_LAB = ("simulate", "evaluate", "render", "demo", "judge", "train")


class _Parser(argparse.ArgumentParser):
    """Argument parser whose errors are one sentence, like those of all other bad input."""

    def error(self, message: str) -> NoReturn:
        raise InputError(f"{message} (see {self.prog} --help)")


def run() -> NoReturn:
    """Run the command as a process, where interruptions after the first one change nothing.

    While Python exits, a signal would kill the process although its results are complete.
    """
    code = INTERRUPTED
    use_one_thread()
    try:
        try:
            code = main()
        finally:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
    except KeyboardInterrupt:
        # A second one, while the first was reported.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.exit(code)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command.

    argv: arguments; those of the process where absent.
    Returns 0 when done, 2 for unusable input or options, 1 for a failure inside.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    _take_any_text()
    # Damaged files are reported here in one sentence, not in OpenCV's log.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    try:
        if any("\0" in word for word in words):
            raise InputError("an argument holds a null character: leave it out")
        if words and words[0] in OF_THE_LAB and words[0] not in commands():
            raise InputError(
                f"{words[0]} is a command of the lab, which is not installed: pip install ./lab in "
                "a clone of the repository")
        parser = make_parser()
        _complete(parser)
        arguments = parser.parse_args(_repeat_calibration(words))
        arguments.func(arguments)
        sys.stdout.flush()
    except InputError as error:
        return _tell(str(error), UNUSABLE)
    except KeyboardInterrupt:
        return _tell("interrupted", INTERRUPTED)
    except BrokenPipeError:
        # Whoever read the output has seen enough, as head does; nor is there more to flush.
        sys.stdout = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115
        return BROKEN_PIPE
    except MemoryError:
        return _tell("there is not enough memory: give smaller images, or fewer --jobs", FAILED)
    except OSError as error:
        where = "" if error.filename is None else f"{printable(error.filename)}: "
        return _tell(f"{where}{error.strerror or error}", FAILED)
    except Exception as error:
        if "--debug" in words:
            traceback.print_exc()
        reason = printable(" ".join(str(error).split()))
        return _tell(
            f"internal error, {type(error).__name__}: {reason} (--debug shows where)", FAILED
        )
    return DONE


def _tell(what: str, code: int) -> int:
    print(f"uw_visibility: {what}", file=sys.stderr)
    return code


def _take_any_text() -> None:
    """Show file names and topics in any encoding of the terminal."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _complete(parser: argparse.ArgumentParser) -> None:
    """Complete words for the shell.

    ``eval "$(register-python-argcomplete uw_visibility)"`` lets it ask.
    """
    if "_ARGCOMPLETE" not in os.environ:
        return
    with needing("completion", "completion"):
        argcomplete = importlib.import_module("argcomplete")
    argcomplete.autocomplete(parser)


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    parser = _Parser(
        prog="uw_visibility",
        description="Underwater visibility, colour and stereo from a stereo camera.",
    )
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    subparsers = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name, command in commands().items():
        subparser = subparsers.add_parser(
            name, help=command.HELP, description=command.DESCRIPTION,
            epilog=getattr(command, "EPILOG", None),
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        command.add_options(subparser)
        subparser.set_defaults(func=command.run)
        subparser.add_argument(
            "--debug", action="store_true", help="show where an internal error arose"
        )
    return parser


@functools.cache
def commands() -> dict[str, Any]:
    """Return the commands by name: a module each, with HELP, DESCRIPTION, add_options and run."""
    added = {point.name: point for point in entry_points(group=GROUP)}
    names = [name for name in OF_THE_LAB if name in added] + sorted(added.keys() - {*OF_THE_LAB})
    return {**COMMANDS, **{name: added[name].load() for name in names}}


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
    run()
