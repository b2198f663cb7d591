# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Runs of ROS on one machine: each in a domain of its own."""

from __future__ import annotations

import os
import socket
from contextlib import ExitStack

import pytest

from uw_visibility.errors import InputError
from uw_visibility_lab.demonstration import node_process


@pytest.fixture
def only(monkeypatch: pytest.MonkeyPatch) -> int:
    """Leave one domain, and ports in which nobody else has reserved it."""
    domain = int(os.environ["ROS_DOMAIN_ID"])
    monkeypatch.setattr(node_process, "DOMAINS", range(domain, domain + 1))
    monkeypatch.setattr(node_process, "FIRST_PORT", node_process.FIRST_PORT - 5)
    return domain


def test_no_two_runs_are_in_one_domain(only: int) -> None:
    for _ in range(2):
        with ExitStack() as runs:
            assert runs.enter_context(node_process.reserved_domain()) == only
            with pytest.raises(InputError, match="no ROS domain is free"):
                runs.enter_context(node_process.reserved_domain())


def test_a_domain_that_a_node_is_in_is_left_alone(only: int) -> None:
    with socket.socket(type=socket.SOCK_DGRAM) as node:
        node.bind(("127.0.0.1", node_process.FIRST_PORT + 250 * only))
        with pytest.raises(InputError), node_process.reserved_domain():
            pass
    with node_process.reserved_domain() as domain:
        assert domain == only


def test_tests_are_in_a_domain_that_others_leave_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    domain = int(os.environ["ROS_DOMAIN_ID"])
    monkeypatch.setattr(node_process, "DOMAINS", range(domain, domain + 1))
    with pytest.raises(InputError), node_process.reserved_domain():
        pass
