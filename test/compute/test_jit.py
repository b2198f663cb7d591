# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Kernels that are kept, cannot be kept, or are damaged."""

from __future__ import annotations

import importlib
import pkgutil
import shutil
from pathlib import Path
from typing import Any

import pytest
from numba.core.dispatcher import Dispatcher

import uw_visibility

pytestmark = pytest.mark.node


def test_a_kernel_within_a_function_is_refused(install: Any) -> None:
    """The values of the function's variables are compiled in, and in no file."""
    install.write("outer", """\
from uw_visibility.compute.jit import njit

def make(number):
    @njit(nogil=True)
    def kernel(x):
        return x + number
    return kernel

try:
    make(1)
except TypeError as error:
    assert "kernel uses variables" in str(error), error
    outer = abs
""")
    assert install.run().value == 3


def test_damaged_files_are_compiled_anew(warm: Any) -> None:
    def flip_a_bit(content: bytes) -> bytes:
        """Change machine code, which ends the process if it is run."""
        middle = len(content) // 2
        return content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1:]

    for damage in (lambda _: b"", lambda content: content[:-9] + 9 * b"\0", flip_a_bit):
        for path in warm.stored():
            path.write_bytes(damage(path.read_bytes()))
        outcome = warm.run()
        assert (outcome.value, outcome.compiled) == (107, 3)
        assert outcome.said.count("is damaged") == 3
    healed = warm.run()
    assert (healed.loaded, healed.compiled, healed.said) == (1, 0, "")


def test_a_kernels_file_in_anothers_place_is_not_taken_for_it(warm: Any) -> None:
    (inner,), = [folder.glob("inner-*") for folder in warm.kernels.glob("*.inner-*")]
    (outer,), = [folder.glob("outer-*") for folder in warm.kernels.glob("*.outer-*")]
    shutil.copy(inner, outer)
    assert warm.run().value == 107


def test_a_full_disk_costs_the_cache_alone(install: Any) -> None:
    # /dev/full says so as a full disk does.
    full = (
        "import os\n"
        "open_file = os.fdopen\n"
        "os.fdopen = lambda number, mode: os.close(number) or open('/dev/full', mode)\n"
    )
    outcome = install.run(code=full + install.call)
    assert outcome.value == 107
    assert outcome.said.count("No space left on device") == 1
    assert not install.stored()


def test_other_packages_keep_numbas_own_cache(install: Any) -> None:
    (install.root / "lib" / "other.py").write_text(
        "import numba\n@numba.njit(cache=True)\ndef double(x):\n    return 2 * x\n"
    )
    use = "import other\nassert other.double(4) == 8\n"
    install.run(code=install.call + use)
    assert len(list((install.root / "lib" / "__pycache__").glob("other.*.nb*"))) == 2


def test_every_kernel_has_this_cache() -> None:
    found = 0
    for info in pkgutil.walk_packages(uw_visibility.__path__, "uw_visibility."):
        if info.name.startswith(("uw_visibility.ros", "uw_visibility.replay")):
            continue
        for name, value in vars(importlib.import_module(info.name)).items():
            if isinstance(value, Dispatcher):
                found += 1
                folder = Path(value.stats.cache_path or "").name
                assert folder.startswith(f"{value.py_func.__module__}-"), (info.name, name)
    assert found > 80


def test_kernel_that_cannot_be_kept_runs_with_a_warning(install: Any) -> None:
    # Large arrays are not compiled in, but pointed to; without optimisation, others too.
    source = install.sources["inner"].replace("return 2 * x", "return TWOS[0] * x")
    array = "import numpy as np\nTWOS = np.full(1_000_000, 2)\n\n@njit"
    install.write("inner", source.replace("@njit", array, 1))
    done = install.run()
    assert done.value == 107
    assert "uw_visibility.inner.helper is compiled at every start" in done.said
