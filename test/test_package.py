# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What is declared, what is installed, and who may import what."""

from __future__ import annotations

import ast
import configparser
import email
import functools
import importlib.metadata
import importlib.util
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
import zipfile
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import pytest
import yaml

import uw_visibility

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "uw_visibility"

# The rosdep key of each module that is not Python's own.
ROSDEP_KEYS = {
    "ament_index_python": "ament_index_python",
    "PIL": "python3-pil",
    "cv2": "python3-opencv",
    "diagnostic_msgs": "diagnostic_msgs",
    "geometry_msgs": "geometry_msgs",
    "jinja2": "python3-jinja2",
    "launch": "launch",
    "launch_ros": "launch_ros",
    "lifecycle_msgs": "lifecycle_msgs",
    "llvmlite": "python3-numba",  # numba is built on it
    "markupsafe": "python3-jinja2",  # which is built on it
    "matplotlib": "python3-matplotlib",
    "nav_msgs": "nav_msgs",
    "numba": "python3-numba",
    "numpy": "python3-numpy",
    "rcl_interfaces": "rcl_interfaces",
    "rclpy": "rclpy",
    "scipy": "python3-scipy",
    "sensor_msgs": "sensor_msgs",
    "std_msgs": "std_msgs",
    "stereo_msgs": "stereo_msgs",
    "tqdm": "python3-tqdm",
    "yaml": "python3-yaml",
}
# rosdep would install rosbags, which brings lz4, with pip: packages for apt must not ask for that.
NOT_IN_APT = {"rosbags", "lz4", "onnxruntime"}
# The name on PyPI of each module that does not come with ROS.
PIP_NAMES = {
    "PIL": "pillow",
    "cv2": "opencv-python-headless",
    "jinja2": "jinja2",
    "llvmlite": "numba",
    "lz4": "lz4",
    "markupsafe": "jinja2",
    "matplotlib": "matplotlib",
    "numba": "numba",
    "numpy": "numpy",
    "onnxruntime": "onnxruntime",
    "rosbags": "rosbags",
    "scipy": "scipy",
    "tqdm": "tqdm",
    "yaml": "PyYAML",
}
CORE = (
    "compute", "config", "enhancement", "errors", "images", "optics", "pipeline", "plausibility",
    "status", "stereo", "water",
)
CORE_MAY_IMPORT = {"PIL", "cv2", "llvmlite", "numba", "numpy", "scipy", "yaml"}

PURE = """
import sys

class Blocker:
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if top in ("rclpy", "rosbags", "ament_index_python") or top.endswith("_msgs"):
            raise ImportError(f"{name} is not there")

sys.meta_path.insert(0, Blocker())

import numpy as np
from uw_visibility import FrameResult, Pipeline, PipelineConfig, StereoRig

rng = np.random.default_rng(1)
wide = np.repeat(np.repeat(rng.integers(0, 256, (60, 100, 3), np.uint8), 2, 0), 2, 1)
left, right = wide[:, :160], wide[:, 8:168]
config = PipelineConfig.from_parameters({"stereo.max_disparity": 32})
rig = StereoRig(focal_length=200.0, baseline=0.1, principal_point=(79.5, 59.5))
result = Pipeline(rig, config).process(left, right)
assert isinstance(result, FrameResult)
matched = np.isfinite(result.disparity)
assert matched.mean() > 0.5, matched.mean()
assert abs(np.median(result.disparity[matched]) - 8.0) < 0.5
assert not any(name.partition(".")[0] in ("rclpy", "rosbags") for name in sys.modules)
"""


def third_party(folder: Path) -> Iterator[tuple[str, str]]:
    """Yield (module of the package, top-level name imported) for what is not Python's own."""
    files = sorted(folder.rglob("*.py")) if folder.is_dir() else [folder]
    for file in files:
        for top in imported(file):
            if top not in sys.stdlib_module_names and top != PACKAGE.name:
                yield str(file.relative_to(ROOT)), top


@functools.cache
def imported(file: Path) -> list[str]:
    """Return the top-level names that a module imports."""
    names: list[str] = []
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names.append(node.module or "")
    return [name.partition(".")[0] for name in names]


def setup_arguments() -> dict[str, Any]:
    """Return what setup.py hands to setup(), read without running it."""
    tree = ast.parse((ROOT / "setup.py").read_text(encoding="utf-8"))
    call = next(
        node for node in ast.walk(tree)
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "setup"
    )
    arguments = {}
    for keyword in call.keywords:
        try:
            arguments[str(keyword.arg)] = ast.literal_eval(keyword.value)
        except ValueError:
            continue
    return arguments


def test_package_xml_and_setup_agree() -> None:
    package = ElementTree.parse(ROOT / "package.xml").getroot()
    setup = setup_arguments()
    assert package.get("format") == "3"
    assert package.findtext("name") == PACKAGE.name
    assert package.findtext("version") == setup["version"]
    maintainer = package.find("maintainer")
    assert maintainer is not None
    assert (maintainer.text, maintainer.get("email")) == (
        setup["maintainer"], setup["maintainer_email"])
    assert package.findtext("license") == setup["license"] == "Apache-2.0"
    assert package.findtext("export/build_type") == "ament_python"


def test_changelog_and_citation_are_of_this_version() -> None:
    version = setup_arguments()["version"]
    changelog = (ROOT / "CHANGELOG.rst").read_text(encoding="utf-8")
    headings = re.findall(r"^(\d\S* \(.*\)|Forthcoming)\n(-+)$", changelog, flags=re.M)
    assert all(len(title) == len(line) for title, line in headings)
    release = next(title for title, _ in headings if title != "Forthcoming")
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert release == f"{version} ({citation['date-released']})"
    assert str(citation["version"]) == version


def test_changes_to_come_are_in_groups_and_told_once() -> None:
    """Rebases of those who work at once have doubled entries, and torn them apart."""
    changelog = (ROOT / "CHANGELOG.rst").read_text(encoding="utf-8")
    coming = re.search(r"^Forthcoming\n-+\n(.*?)^\d\S* \(", changelog, flags=re.M | re.S)
    lines = [line for line in coming[1].splitlines() if line] if coming else []
    assert all(re.match(r"\* \*\*[^*]+\*\*$|  \* |    \S", line) for line in lines)
    assert sorted(lines) == sorted(set(lines))


def test_every_import_is_declared_for_rosdep_and_for_pip() -> None:
    package = ElementTree.parse(ROOT / "package.xml").getroot()
    keys = {element.text for element in package if element.tag.endswith("depend")}
    setup = setup_arguments()
    requirements = list(chain(setup["install_requires"], *setup["extras_require"].values()))
    pip = {requirement.partition(">")[0] for requirement in requirements}
    for folder in (PACKAGE, ROOT / "launch"):
        for file, name in third_party(folder):
            if name not in NOT_IN_APT:
                assert ROSDEP_KEYS[name] in keys, f"{file} imports {name}"
            assert PIP_NAMES.get(name, "numpy") in pip, f"{file} imports {name}"


def test_everything_that_rosdep_installs_comes_from_apt() -> None:
    package = ElementTree.parse(ROOT / "package.xml").getroot()
    keys = {str(element.text) for element in package if element.tag.endswith("depend")}
    assert not {key for key in keys if key.endswith("-pip")}
    assert not {key for key in keys for name in NOT_IN_APT if name in key}


NO_ROSBAGS = """
import sys

class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "rosbags":
            raise ModuleNotFoundError(name)

sys.meta_path.insert(0, Blocker())
from uw_visibility.cli import main
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.parametrize("words", [["replay", ".", "-o", "out"], ["simulate", "-o", "out"]])
def test_commands_say_how_to_get_rosbags_where_it_is_missing(
    words: list[str], tmp_path: Path
) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", NO_ROSBAGS, *words], cwd=tmp_path, text=True, check=False,
        capture_output=True,
    )
    assert (ended.stdout, ended.returncode) == ("", 2)
    assert "rosbags, which is not installed: pip install rosbags" in ended.stderr
    assert ended.stderr.count("\n") == 1


def test_the_core_imports_its_few_libraries_only() -> None:
    for name in CORE:
        for path in (PACKAGE / name, PACKAGE / f"{name}.py"):
            if path.exists():
                imported = {(file, top) for file, top in third_party(path)}
                # Where a network is asked for, and in this file only.
                imported.discard(("uw_visibility/images/network.py", "onnxruntime"))
                assert {pair for pair in imported if pair[1] not in CORE_MAY_IMPORT} == set()


def test_executables_are_where_ros2_run_looks() -> None:
    setup_cfg = configparser.ConfigParser()
    setup_cfg.read(ROOT / "setup.cfg")
    assert setup_cfg["develop"]["script_dir"] == "$base/lib/uw_visibility"
    assert setup_cfg["install"]["install_scripts"] == "$base/lib/uw_visibility"


def test_every_source_file_names_its_licence() -> None:
    for folder in ("uw_visibility", "test", "benchmarks", "launch"):
        for file in (ROOT / folder).rglob("*.py"):
            head = file.read_text(encoding="utf-8").splitlines()[:2]
            assert "# SPDX-License-Identifier: Apache-2.0" in head, file.relative_to(ROOT)


def test_scripts_beside_the_package_import_what_is_there() -> None:
    files = [file for folder in ("benchmarks", "docs/examples", "launch", "test/faults", "tools")
             for file in sorted((ROOT / folder).iterdir()) if file.is_file()]
    names = [
        (str(file.relative_to(ROOT)), node.module, name.name)
        for file in files
        if file.suffix == ".py" or file.read_bytes().startswith(b"#!/usr/bin/env python3")
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("uw_visibility")
        for name in node.names]
    assert len(names) > 50
    missing = [
        (file, module, name) for file, module, name in names
        if importlib.util.find_spec(module) is None
        or not (hasattr(importlib.import_module(module), name)
                or importlib.util.find_spec(f"{module}.{name}"))]
    assert missing == []


def test_the_core_runs_without_ros_and_rosbags() -> None:
    done = subprocess.run(
        [sys.executable, "-c", PURE], cwd=ROOT, capture_output=True, text=True, check=False,
    )
    assert done.returncode == 0, done.stderr


def setuptools_version() -> tuple[int, ...]:
    try:
        version = importlib.metadata.version("setuptools")
    except importlib.metadata.PackageNotFoundError:
        return (0,)
    return tuple(int(number) for number in version.split(".")[:2])


INSTALLED = ("config", "launch", "foxglove", "integration")


def copy_sources(tree: Path) -> None:
    """Copy what a build takes."""
    for name in ("uw_visibility", "resource", *INSTALLED):
        shutil.copytree(ROOT / name, tree / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("setup.py", "setup.cfg", "pyproject.toml", "package.xml", "LICENSE", "README.md"):
        shutil.copy(ROOT / name, tree)


def test_setup_is_called_from_anywhere(tmp_path: Path) -> None:
    """As colcon build --symlink-install does by a link, beside which not all files are."""
    for name in ("setup.py", "setup.cfg", "uw_visibility", "resource"):
        (tmp_path / name).symlink_to(ROOT / name)
    for script in (ROOT / "setup.py", tmp_path / "setup.py"):
        told = subprocess.run(
            [sys.executable, str(script), "--quiet", "--name", "--long-description"],
            cwd=tmp_path, capture_output=True, text=True, check=True,
        ).stdout
        assert told.startswith("uw_visibility\n# uw_visibility\n")


@pytest.mark.node
@pytest.mark.parametrize("how", [[], ["--symlink-install"]], ids=["copies", "links"])
def test_colcon_installs_what_ros_looks_for(how: list[str], tmp_path: Path) -> None:
    colcon = shutil.which("colcon")
    if colcon is None:
        pytest.skip("colcon is not installed: pip install colcon-common-extensions")
    copy_sources(tmp_path / "src" / "uw_visibility")
    done = subprocess.run(
        [colcon, "build", *how], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    install = tmp_path / "install" / "uw_visibility"
    for folder in INSTALLED:
        there = {path.name for path in (install / "share" / "uw_visibility" / folder).iterdir()}
        wanted = {path.name for path in (ROOT / folder).iterdir() if path.is_file()}
        assert there == wanted
    executables = {path.name for path in (install / "lib" / "uw_visibility").iterdir()}
    assert executables >= {"uw_visibility_node", "uw_visibility_lifecycle_node"}
    assert (install / "share/ament_index/resource_index/packages/uw_visibility").is_file()


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    """The wheel that `pip install .` would make."""
    # setuptools builds wheels by itself since version 70.1.
    if importlib.util.find_spec("pip") is None or setuptools_version() < (70, 1):
        pytest.skip("no wheel can be built here: pip or setuptools 70.1 is not installed")
    folder = tmp_path_factory.mktemp("wheel")
    tree = folder / "tree"
    # A build leaves folders of its own beside the sources.
    copy_sources(tree)
    subprocess.run(
        [
            sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-index",
            "--no-build-isolation", "--wheel-dir", str(folder), str(tree),
        ],
        check=True, capture_output=True,
    )
    return zipfile.ZipFile(next(folder.glob("*.whl")))


def test_the_wheel_holds_modules_tables_and_what_ament_looks_for(wheel: zipfile.ZipFile) -> None:
    names = set(wheel.namelist())
    for file in PACKAGE.rglob("*"):
        if file.is_file() and file.suffix in (".py", ".csv", ".html", ".txt", ".typed"):
            assert str(file.relative_to(ROOT)) in names
    shared = {name.partition(".data/data/share/")[2] for name in names}
    assert "ament_index/resource_index/packages/uw_visibility" in shared
    assert "uw_visibility/package.xml" in shared
    for folder in INSTALLED:
        for file in (ROOT / folder).glob("*.*"):
            assert f"uw_visibility/{folder}/{file.name}" in shared
    assert not any(name.startswith(("test", "benchmarks")) for name in names)


def test_the_wheel_says_what_it_is_and_installs_without_ros(wheel: zipfile.ZipFile) -> None:
    name = next(name for name in wheel.namelist() if name.endswith("METADATA"))
    metadata = email.message_from_bytes(wheel.read(name))
    assert metadata["Version"] == setup_arguments()["version"]
    assert metadata["Requires-Python"] == ">=3.11"
    assert metadata["License-File"] == "LICENSE"
    assert metadata["Description-Content-Type"] == "text/markdown"
    assert metadata.get_payload().startswith("# uw_visibility")
    needed = metadata.get_all("Requires-Dist", [])
    plain = {words for words in needed if "extra ==" not in words}
    assert {"ros", "rosbags", "matplotlib"}.isdisjoint(re.split(r"\W", " ".join(plain)))
    replay = {words.partition(";")[0] for words in needed if 'extra == "replay"' in words}
    extras = setup_arguments()["extras_require"]
    assert replay == {*extras["report"], *extras["recordings"]}


def test_the_source_distribution_holds_all_that_a_clone_has() -> None:
    listed = [
        line.split() for line in (ROOT / "MANIFEST.in").read_text(encoding="utf-8").splitlines()
    ]
    held = {
        name.split("/")[0]
        for line in listed if line and line[0] in ("include", "graft") for name in line[1:]
    }
    tracked = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False,
    )
    if tracked.returncode != 0:
        pytest.skip("this is no clone of the repository: git does not know its files")
    # setuptools adds these by itself.
    held |= {"uw_visibility", "setup.py", "MANIFEST.in"}
    assert {name.split("/")[0] for name in tracked.stdout.split()} - held == set()


def test_the_version_is_that_of_the_installed_package() -> None:
    assert uw_visibility.__version__ == importlib.metadata.version("uw_visibility")


def test_the_wheel_declares_both_executables(wheel: zipfile.ZipFile) -> None:
    name = next(name for name in wheel.namelist() if name.endswith("entry_points.txt"))
    entry_points = configparser.ConfigParser()
    entry_points.read_string(wheel.read(name).decode())
    scripts = dict(entry_points["console_scripts"])
    assert set(scripts) == {
        "uw_visibility", "uw_visibility_node", "uw_visibility_lifecycle_node"
    }
    for target in scripts.values():
        module, _, function = target.partition(":")
        source = (ROOT / (module.replace(".", "/") + ".py")).read_text(encoding="utf-8")
        functions = [n.name for n in ast.parse(source).body if isinstance(n, ast.FunctionDef)]
        assert function in functions, target
