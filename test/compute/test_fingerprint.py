# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Which changes make kernels stale."""

from __future__ import annotations

from typing import Any

import pytest

from uw_visibility.compute import kernel_folder

pytestmark = pytest.mark.node


def test_a_kernel_is_compiled_once_and_anew_after_any_change(install: Any) -> None:
    first = install.run(fresh=True)
    assert (first.value, first.loaded, first.compiled) == (107, 0, 3)
    assert first.folder == install.kernels
    again = install.run(fresh=True)
    assert (again.value, again.loaded, again.compiled) == (107, 1, 0)

    # The outer kernel's file stays the same in all that follows.
    install.replace("inner", "2 * x", "5 * x")
    assert install.run().value == 116
    install.write("constants", "OFFSET = 500\n")
    assert install.run().value == 516
    assert install.run(fresh=True, NUMBA_OPT="1").compiled == 3

    # Back at what was there before, it is compiled anew, ...
    install.write("inner", install.sources["inner"])
    install.write("constants", install.sources["constants"])
    assert install.run().value == 107
    # ... since what is kept of other versions has an end.
    versions = [path.name for path in install.kernels.iterdir()]
    for module in ("inner", "outer"):
        kept = [name for name in versions if name.startswith(f"uw_visibility.{module}-")]
        assert len(kept) == 1 + kernel_folder.KEPT_VERSIONS


def test_a_constant_of_another_module_is_known_however_it_is_imported(install: Any) -> None:
    imports = [
        "from uw_visibility import constants",
        "from uw_visibility import (\n    errors,\n    constants,\n)",
        "import uw_visibility.constants as constants",
        "if True:\n    from uw_visibility import constants",
        "",
    ]
    for number, line in enumerate(imports):
        install.write(f"importer_{number}", line)
    names = [f"uw_visibility.importer_{number}" for number in range(len(imports))]
    code = (
        "import json\nfrom uw_visibility.compute.kernel_folder import fingerprint\n"
        f"print(json.dumps([[fingerprint(name) for name in {names}], 0, 0, '']))\n"
    )
    before = install.run(code=code).value
    install.write("constants", "OFFSET = 200\n")
    after = install.run(code=code).value
    assert [old != new for old, new in zip(before, after, strict=True)] == [True] * 4 + [False]


def test_what_is_on_disk_is_compiled_into_what_calls_it(warm: Any) -> None:
    warm.replace("outer", "+ 1", "+ 2")
    outcome = warm.run()
    assert (outcome.value, outcome.loaded, outcome.compiled) == (108, 1, 1)


def test_a_change_while_a_process_runs_is_not_taken_for_its_code(install: Any) -> None:
    """An upgrade under a running node: what it compiles from then on is of the old code."""
    upgrade = (
        "import uw_visibility.outer, pathlib\n"
        "file = pathlib.Path(uw_visibility.outer.__file__)\n"
        "file.write_text(file.read_text().replace('+ 1', '+ 2'))\n"
    )
    assert install.run(code=upgrade + install.call).value == 107
    assert install.run().value == 108
