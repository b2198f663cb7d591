# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A synthetic view whose water is known."""

import pytest
from scenes import water_view


@pytest.fixture
def make_view():
    """Maker of views, see `scenes.water_view`."""
    return water_view
