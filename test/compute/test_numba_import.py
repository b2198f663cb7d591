# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Numba's settings: those of the environment, not of the current folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.node


@pytest.mark.parametrize(
    "settings",
    [
        "disable_jit: 1\ncache_dir: {hostile}\ncache_locator_classes: hostile.Locator\nopt: 0\n",
        "[no mapping]\n",
    ],
)
def test_numbas_settings_in_the_current_folder_change_nothing(
    warm: Any, tmp_path: Path, settings: str
) -> None:
    downloaded = tmp_path / "downloaded"
    downloaded.mkdir()
    hostile = downloaded / "kernels"
    (downloaded / ".numba_config.yaml").write_text(settings.format(hostile=hostile))
    (downloaded / "hostile.py").write_text(f"open({str(downloaded / 'mark')!r}, 'w')\n")
    # Another type is compiled, before which numba reads its settings again.
    check = (
        "assert outer(0.5) == 102.0\n"
        "import numba, os\n"
        "assert not numba.config.DISABLE_JIT and not numba.config.CACHE_DIR\n"
        "assert numba.config.OPT == 3 and os.getcwd().endswith('downloaded')\n"
    )
    outcome = warm.run(code=warm.call + check, cwd=downloaded, fresh=True)
    assert (outcome.value, outcome.loaded, outcome.folder) == (107, 1, warm.kernels)
    assert {path.name for path in downloaded.iterdir()} == {".numba_config.yaml", "hostile.py"}


def test_the_users_own_settings_hold(warm: Any) -> None:
    outcome = warm.run(fresh=True, NUMBA_DISABLE_JIT="1")
    assert (outcome.value, outcome.loaded, outcome.compiled) == (107, 0, 0)
