# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Imports numba without settings from the current folder.

Numba reads ``.numba_config.yaml`` from the current folder, when it is imported and before
each compilation. Who works in a folder that came from elsewhere, such as a downloaded
recording, would run kernels as its author says, or none. Environment variables ``NUMBA_*``
hold as they do elsewhere. Who imports numba before this package has chosen, and keeps it.
The package imports it from here alone.
"""

from __future__ import annotations

import contextlib
import os
import sys
from pathlib import Path

_SETTINGS_FILE = Path(".numba_config.yaml")


def _elsewhere() -> contextlib.AbstractContextManager[None]:
    """Leave the current folder while numba is imported, if that is what it would read."""
    # lexists: a link may lead anywhere by the time that it is read.
    if os.path.lexists(_SETTINGS_FILE):
        return contextlib.chdir(Path(__file__).parent)
    return contextlib.nullcontext()


_first = "numba" not in sys.modules
with _elsewhere() if _first else contextlib.nullcontext():
    import llvmlite
    import numba
    from llvmlite import ir
    from numba import types
    from numba.core import caching, cgutils, config
    from numba.core.serialize import dumps
    from numba.extending import intrinsic, register_jitable

if _first:
    # Private: numba has no other way to say that there is no file of settings.
    config._config_fname = os.devnull

__all__ = [
    "caching", "cgutils", "dumps", "intrinsic", "ir", "llvmlite", "numba", "register_jitable",
    "types",
]
