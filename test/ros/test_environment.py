# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What a launch file adds to the node's environment."""

from __future__ import annotations

from uw_visibility.ros.start import PUBLICATION, node_environment


def test_what_the_environment_says_holds() -> None:
    assert node_environment({"HOME": "/"}) == PUBLICATION
    assert node_environment(dict.fromkeys(PUBLICATION, "given")) == {}
