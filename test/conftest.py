# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What the tests share."""

from pathlib import Path

import pytest
from hypothesis import settings

# The first example of a compiled kernel includes its compilation.
settings.register_profile("project", deadline=None)
settings.load_profile("project")

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of recorded test data beside the checkout; skips where it is absent."""
    if not DATA.is_dir():
        pytest.skip(f"no recorded test data: {DATA.parent.name}/{DATA.name} is not beside the tree")
    return DATA
