# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What the tests share, and how processes share the tests.

Much of the suite waits, for nodes and processes that start, or has one thread. So
pytest-xdist runs the whole of it (`python -m pytest`) in four processes, a file of tests
in one of them. Tests that are named, as by `python -m pytest test/test_pair.py`, run in
pytest's own process, and so does everything with `-n 0` or without pytest-xdist.
"""

from __future__ import annotations

import fcntl
import gc
import os
import resource
import signal
import sys
import tempfile
from collections.abc import Callable, Generator, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from uw_visibility.compute.threads import use_one_thread
from uw_visibility_lab.demonstration.node_process import reserved_domain

# A test that waits for ever would keep other processes from what it holds. It fails after this
# time, s, where pytest-timeout is installed; the slowest takes two minutes on a slow machine.
PATIENCE = 600.0
# Of four workers two wait for nodes and processes most of the time.
WORKERS = 4
NODE_FIXTURES = {"start_node", "make_client"}
# The laboratory, lamps, whose kernels take half a minute to compile, what guards fitted constants,
# renders or damages much, or compiles anew: for `make studies`; `make test` leaves them out.
LONG = (
    "lab/test/",
    "test/compute/test_fingerprint.py", "test/compute/test_numba_import.py",
    "test/enhancement/test_lamp_radiance.py",
    "test/faults/test_fuzz.py", "test/faults/test_results.py", "test/faults/test_soak.py",
    "test/pipeline/test_coincidence.py", "test/pipeline/test_degenerate.py",
    "test/pipeline/test_lamp_survey.py", "test/pipeline/test_lamps.py",
    "test/pipeline/test_tracking.py",
    "test/plausibility/test_transect.py",
    "test/replay/bags/test_damage.py", "test/replay/bags/test_limits.py",
    "test/replay/test_calibrate.py", "test/replay/test_calibrate_lighting.py",
    "test/replay/test_cluster.py", "test/replay/test_node_parity.py", "test/replay/test_stores.py",
    "test/ros/test_cold_start.py", "test/ros/test_node_lamps.py",
    "test/water/daylight/test_coverage.py", "test/water/lamps/",
    "test/water/series/test_survey.py",
)

# Files that wait for processes rather than compute, beside those that start nodes by fixtures.
WAITING = {
    "test/faults/test_fuzz.py", "test/faults/test_soak.py", "test/ros/test_run.py",
    "test/ros/test_start.py",
}

# The first example of a compiled kernel includes its compilation, and how long the making of
# examples takes is a matter of how busy the machine is. The same examples in every run; with
# `--hypothesis-profile=explore` others, and more.
UNTIMED: dict[str, Any] = {
    "deadline": None, "suppress_health_check": [HealthCheck.too_slow], "print_blob": True}
settings.register_profile("project", derandomize=True, **UNTIMED)
settings.register_profile("explore", max_examples=500, **UNTIMED)
settings.load_profile("project")

HERE = Path(__file__).resolve().parent
DATA = HERE.parent / "shared" / "data"
TURNS = pytest.StashKey[tempfile.TemporaryDirectory[str]]()


# Before NumPy is imported, here and in the processes that tests start: as the command does.
use_one_thread()
# Those many processes compile the modules once, and workers rewrite assertions once.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
# Before ROS is started, here and in the processes that tests start; until this process ends.
RESERVED = ExitStack()
os.environ["ROS_DOMAIN_ID"] = str(RESERVED.enter_context(reserved_domain()))
# Warnings of NumPy are errors in the processes that tests start, too; see pyproject.toml.
os.environ["PYTHONWARNINGS"] = "error::RuntimeWarning"
# What a shell starts in the background ignores interruptions, and so would those processes.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config: pytest.Config) -> None:
    """End tests that hang, and share the whole suite among processes, unless told otherwise."""
    option = config.option
    if config.pluginmanager.hasplugin("timeout") and option.timeout is None:
        option.timeout = PATIENCE
    if (
        config.args_source is pytest.Config.ArgsSource.TESTPATHS
        # Else each worker would start workers.
        and not hasattr(config, "workerinput")
        and config.pluginmanager.hasplugin("xdist")
        and (option.numprocesses, option.dist) == (None, "no")
        and not (option.usepdb or option.trace or option.collectonly or option.capture == "no")
        and (os.cpu_count() or 1) > 1
    ):
        option.numprocesses = WORKERS
        # Tests of a file share nodes and scenes, and the order of files keeps the long ones
        # from coming last.
        option.dist = "loadfile"
        option.loadscopereorder = False


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: Any) -> None:
    """Tell a worker of pytest-xdist where the locks are by which the workers take turns."""
    stash = node.config.stash
    if TURNS not in stash:
        stash[TURNS] = tempfile.TemporaryDirectory(prefix="uw_visibility_test_")
        node.config.add_cleanup(stash[TURNS].cleanup)
    node.workerinput["turns"] = stash[TURNS].name


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Let the garbage collector not look through what is imported and collected, which stays."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.freeze()


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave out what `make test` would import in each worker only to deselect it."""
    if "not long" not in config.option.markexpr:
        return None
    name = str(collection_path.relative_to(HERE)) + "/" * collection_path.is_dir()
    return True if name.startswith(LONG) else None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark as `node` what starts nodes through the fixtures that do, and what takes long.

    Where workers share the whole suite, files that wait are spread among those that compute:
    in the folder's order both workers would meet in test/ros, and the processors be idle.
    The last files come first: at the end of the folders' order are longer ones than at its
    beginning, and one worker would be left with such a one while the others have done.
    """
    for item in items:
        if str(item.path.relative_to(HERE)).startswith(LONG):
            item.add_marker(pytest.mark.long)
        if NODE_FIXTURES & set(getattr(item, "fixturenames", ())):
            item.add_marker(pytest.mark.node)
    if hasattr(config, "workerinput"):
        items[:] = spread(items)


def spread(items: list[pytest.Item]) -> list[pytest.Item]:
    """Return tests in an order of files that has those that wait at even distances."""
    files: dict[str, list[pytest.Item]] = {}
    for item in items:
        files.setdefault(str(item.path.relative_to(HERE)), []).append(item)
    groups: dict[bool, list[str]] = {}
    for name, tests in files.items():
        starts_nodes = any(NODE_FIXTURES & set(getattr(test, "fixturenames", ())) for test in tests)
        groups.setdefault(starts_nodes or name in WAITING, []).append(name)
    places = {name: number / len(group) for group in groups.values()
              for number, name in enumerate(group)}
    order = sorted(files, key=places.__getitem__, reverse=True)
    return [item for name in order for item in files[name]]


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Run a test that is marked `alone` while no other worker runs one."""
    turns = getattr(item.config, "workerinput", {}).get("turns")
    if turns is None:
        return (yield)
    kind = fcntl.LOCK_EX if item.get_closest_marker("alone") else fcntl.LOCK_SH
    with Path(turns, "room").open("a") as room:
        with Path(turns, "door").open("a") as door:
            # Who waits for the room keeps the door, so that none who comes later overtakes.
            fcntl.flock(door, fcntl.LOCK_EX)
            fcntl.flock(room, kind)
        try:
            return (yield)
        finally:
            # Closing would not do: processes that the test has forked may have the file too.
            fcntl.flock(room, fcntl.LOCK_UN)


@pytest.fixture
def hostile_folder(tmp_path: Path) -> Path:
    """Folder of modules named like those that are imported first; any makes the file `ran`."""
    folder = tmp_path / "hostile"
    folder.mkdir()
    mark = f"open({str(folder / 'ran')!r}, 'a').write(__name__ + chr(10))\n"
    for name in ("concurrent", "logging", "multiprocessing", "numpy", "pickle", "uw_visibility"):
        (folder / f"{name}.py").write_text(mark, encoding="utf-8")
    return folder


@contextmanager
def _disk_of(size: int) -> Iterator[None]:
    """Let no file grow beyond so many bytes: what is written fails as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)


@pytest.fixture
def full_disk() -> Callable[[int], AbstractContextManager[None]]:
    """Make a disk that is full at so many bytes a file."""
    return _disk_of


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of recorded test data beside the checkout; skips where it is absent."""
    if not DATA.is_dir():
        pytest.skip(f"no recorded test data: {DATA.parent.name}/{DATA.name} is not beside the tree")
    return DATA
