# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The node while it compiles: it says so, and how far it is."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest


def test_says_that_it_compiles_and_how_far_it_is(
    start_node: Callable[..., Any], make_client: Callable[..., Any], tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    client = make_client(namespace="/cold")
    monkeypatch.setitem(client.environment, "NUMBA_CACHE_DIR", str(tmp_path))
    node = start_node("-r", "__ns:=/cold", ready=False, fresh=True)
    node.wait_for(f"kernels are kept in {tmp_path / 'uw_visibility'}")
    first = client.diagnosed("pipeline", "the pipeline is being compiled, ").message
    client.wait(lambda: client.diagnosis("pipeline").message != first, "another count", 100.0)
    counts = [
        re.search(r"is being compiled, kernels so far: (\d+)$", message)
        for message in (first, client.diagnosis("pipeline").message)
    ]
    assert all(counts) and int(counts[0][1]) < int(counts[1][1]), counts
