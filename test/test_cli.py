# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The command itself: version and completion."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

import uw_visibility
from uw_visibility.cli import main
from uw_visibility.commands import warmup
from uw_visibility.replay.progress import say

RUN = (sys.executable, "-c", "from uw_visibility.cli import run; run()")


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert not ended.value.code
    assert capsys.readouterr().out == f"uw_visibility {uw_visibility.__version__}\n"


def test_interruptions_beyond_the_first_change_nothing() -> None:
    """One while the first is told, and one while Python ends, which would end it by force."""
    script = """if True:
        import atexit, signal, sys
        from uw_visibility.cli import run

        class Impatient:
            def __init__(self, stream):
                self.stream = stream
            def write(self, text):
                signal.raise_signal(signal.SIGINT)
                self.stream.write(text)
            def flush(self):
                self.stream.flush()

        atexit.register(signal.raise_signal, signal.SIGINT)
        if sys.argv[2:] == ["impatient"]:
            sys.stderr = Impatient(sys.stderr)
        sys.stdout = Impatient(sys.stdout)
        del sys.argv[2:]
        run()
    """
    for more, told in (([], "uw_visibility: interrupted\n"), (["impatient"], "")):
        done = subprocess.run(
            [sys.executable, "-c", script, "--version", *more], capture_output=True, text=True,
            check=False)
        assert (done.returncode, done.stdout, done.stderr) == (130, "", told)


def test_output_may_be_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(warmup, "run", lambda arguments: (say("done"), sys.stderr.isatty()))
    for name in ("stdout", "stderr"):
        monkeypatch.setattr(sys, name, None)
    assert main(["warmup"]) == 0


def completed(line: str, tmp_path: Path) -> subprocess.CompletedProcess[str]:
    """Ask what a line may become, as a shell does."""
    return subprocess.run(
        RUN, capture_output=True, text=True, check=False, env={
            **os.environ, "COMP_LINE": line, "COMP_POINT": str(len(line)), "_ARGCOMPLETE": "1",
            "_ARGCOMPLETE_STDOUT_FILENAME": str(tmp_path / "words"), "_ARGCOMPLETE_IFS": " ",
        },
    )


def test_the_shell_completes_commands_and_options(tmp_path: Path) -> None:
    if importlib.util.find_spec("argcomplete") is None:
        pytest.skip("the extra completion is not installed")
    assert completed("uw_visibility rep", tmp_path).returncode == 0
    assert (tmp_path / "words").read_text().split() == ["replay"]
    completed("uw_visibility replay --join", tmp_path)
    assert (tmp_path / "words").read_text().split() == ["--join", "--join-tolerance"]


def test_the_package_runs_as_a_module_too() -> None:
    told = subprocess.run(
        [sys.executable, "-m", "uw_visibility", "--version"],
        capture_output=True, text=True, check=True, timeout=60)
    assert uw_visibility.__version__ in told.stdout
