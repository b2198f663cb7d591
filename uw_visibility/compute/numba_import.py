# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Import of numba that ignores settings in the current folder.

Numba reads ``.numba_config.yaml`` from the current folder, when it is imported and before
each compilation. In a folder from elsewhere, such as a downloaded recording, this file could
change or disable kernels. Environment variables ``NUMBA_*`` apply as usual. If numba was
imported before this package, its settings are kept. The package imports numba only from here.
"""

from __future__ import annotations

import contextlib
import os
import sys
from pathlib import Path

_first = "numba" not in sys.modules
# lexists, since the target of a link may appear before numba reads it.
_leave = _first and os.path.lexists(".numba_config.yaml")
with contextlib.chdir(Path(__file__).parent) if _leave else contextlib.nullcontext():
    import llvmlite
    import numba
    from llvmlite import ir
    from numba import types
    from numba.core import caching, cgutils, config
    from numba.core.serialize import dumps
    from numba.extending import intrinsic, register_jitable

if _first:
    # Private: numba has no other way to switch the file of settings off.
    config._config_fname = os.devnull

__all__ = [
    "caching", "cgutils", "dumps", "intrinsic", "ir", "llvmlite", "numba", "register_jitable",
    "types",
]
