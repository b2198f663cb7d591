# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The command itself: version, completion, interruption."""

from __future__ import annotations

import importlib.util
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import uw_visibility
from uw_visibility.cli import main

RUN = (sys.executable, "-c", "import sys; from uw_visibility.cli import main; sys.exit(main())")


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert not ended.value.code
    assert capsys.readouterr().out == f"uw_visibility {uw_visibility.__version__}\n"


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


@pytest.mark.node
def test_an_interruption_at_the_start_of_jobs_is_one_sentence(tmp_path: Path) -> None:
    """Ctrl-C reaches every process of the terminal, those that are still importing too."""
    pytest.importorskip("rosbags")
    bag = tmp_path / "bag"
    size = ["--width", "160", "--height", "120", "--frames", "9"]
    assert main(["simulate", "-o", str(bag), *size]) == 0
    command = [*RUN, "replay", str(bag), "-o", str(tmp_path / "out"), "--jobs", "2"]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    )
    time.sleep(1.5)
    os.killpg(process.pid, signal.SIGINT)
    told = process.communicate(timeout=60)[1]
    if process.returncode == -signal.SIGINT:
        pytest.skip("Python itself was still starting")
    assert process.returncode == 130
    sentences = told.splitlines()
    assert sentences[-1] == "uw_visibility: interrupted"
    # Once there are frames, a second one says how to go on.
    assert len(sentences) == 1 or "--resume goes on from it" in sentences[0]
    assert len(sentences) <= 2
