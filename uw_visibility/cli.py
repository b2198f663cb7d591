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
from typing import Any, NoReturn, TextIO

from uw_visibility import __version__
from uw_visibility.commands import calibrate, enhance, replay, warmup
from uw_visibility.compute.memory import keep_freed_memory
from uw_visibility.compute.threads import use_one_thread
from uw_visibility.errors import InputError, needing, printable

DONE, FAILED, UNUSABLE = 0, 1, 2
INTERRUPTED, BROKEN_PIPE = 130, 141
COMMANDS = {"enhance": enhance, "replay": replay, "calibrate": calibrate, "warmup": warmup}
# Other distributions add commands by entry points of this group.
GROUP = "uw_visibility.commands"
# Commands of the lab, which may not be installed.
OF_THE_LAB = ("simulate", "evaluate", "render", "demo", "judge", "train")


class _Parser(argparse.ArgumentParser):
    """Argument parser that reports errors as `InputError`, like all other bad input."""

    def error(self, message: str) -> NoReturn:
        raise InputError(f"{message} (see {self.prog} --help)")


def run() -> NoReturn:
    """Run the command as a process, and ignore interruptions after its end.

    While Python exits, a signal would kill the process although its results are complete.
    """
    code = INTERRUPTED
    use_one_thread()
    keep_freed_memory()
    try:
        try:
            code = main()
        finally:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
    except KeyboardInterrupt:
        # A second interruption, while the first one was reported.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.exit(code)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command.

    argv: arguments; by default those of the process.
    Returns 0 when done, 2 for unusable input or options, 1 for other errors, 130 when interrupted,
    141 for a closed output.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    _prepare_output()
    # Damaged files are reported here in one sentence, not in OpenCV's log.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    try:
        if any("\0" in word for word in words):
            raise InputError("an argument has a null character: remove it")
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
        return _fail(str(error), UNUSABLE)
    except KeyboardInterrupt:
        return _fail("interrupted", INTERRUPTED)
    except BrokenPipeError:
        # The reader of the output has closed it, as head does: do not flush the rest at exit.
        sys.stdout = _nowhere()
        return BROKEN_PIPE
    except MemoryError:
        return _fail("there is not enough memory: give smaller images, or fewer --jobs", FAILED)
    except OSError as error:
        where = "" if error.filename is None else f"{printable(error.filename)}: "
        return _fail(f"{where}{error.strerror or error}", FAILED)
    except Exception as error:
        if "--debug" in words:
            traceback.print_exc()
        reason = printable(" ".join(str(error).split()))
        return _fail(
            f"internal error, {type(error).__name__}: {reason} (--debug shows where)", FAILED
        )
    return DONE


def _fail(message: str, code: int) -> int:
    """Print an error message; return the exit code."""
    print(f"uw_visibility: {message}", file=sys.stderr)
    return code


def _prepare_output() -> None:
    """Escape characters of file names and topics that the terminal's encoding does not have.

    A stream that is closed, as after ``>&-`` in a shell, is None: its output goes nowhere.
    """
    sys.stdout = sys.stdout or _nowhere()
    sys.stderr = sys.stderr or _nowhere()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _nowhere() -> TextIO:
    return Path(os.devnull).open("w", encoding="utf-8")


def _complete(parser: argparse.ArgumentParser) -> None:
    """Complete words, after ``eval "$(register-python-argcomplete uw_visibility)"`` in a shell."""
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
            "--debug", action="store_true", help="show the traceback of an internal error"
        )
    return parser


@functools.cache
def commands() -> dict[str, Any]:
    """Return the commands by name: modules with HELP, DESCRIPTION, add_options and run."""
    added = {point.name: point for point in entry_points(group=GROUP)}
    names = [name for name in OF_THE_LAB if name in added] + sorted(added.keys() - {*OF_THE_LAB})
    return {**COMMANDS, **{name: added[name].load() for name in names}}


def _repeat_calibration(words: Sequence[str]) -> list[str]:
    """Turn ``--calibration LEFT.yaml RIGHT.yaml`` into two uses of the option.

    argparse has no option of one or two values: "one or more" would include the
    images that follow.
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
