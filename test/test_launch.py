# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The launch file is Python, and describes a node where launch is installed."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

FILE = Path(__file__).resolve().parents[1] / "launch" / "uw_visibility.launch.py"


@pytest.mark.parametrize("file", sorted(FILE.parent.glob("*.launch.py")), ids=lambda f: f.name)
def test_launch_file_compiles(file: Path) -> None:
    code = compile(file.read_text(encoding="utf-8"), file.name, "exec")
    assert "generate_launch_description" in code.co_names


@pytest.mark.parametrize(("lifecycle", "actions"), [
    ("false", ["Node"]),
    ("true", ["RegisterEventHandler", "RegisterEventHandler", "LifecycleNode"]),
])
def test_launch_file_describes_the_node(lifecycle: str, actions: list[str]) -> None:
    for name in ("launch", "launch_ros", "ament_index_python"):
        pytest.importorskip(name, reason=f"{name} is not among the ROS packages on PyPI")
    index = pytest.importorskip("ament_index_python.packages")
    try:
        index.get_package_share_path("uw_visibility")
    except index.PackageNotFoundError:
        pytest.skip("the package is not in an ament index: build it with colcon")
    import launch

    description = runpy.run_path(str(FILE))["generate_launch_description"]()
    context = launch.LaunchContext()
    for argument in description.get_launch_arguments():
        argument.visit(context)
    context.launch_configurations["lifecycle"] = lifecycle
    nodes = [
        action for entity in description.entities[-1:] for action in entity.execute(context) or []
    ]
    assert [type(node).__name__ for node in nodes] == actions
