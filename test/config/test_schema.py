# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Parameter files, and the one that ships against config/schema.py."""

from __future__ import annotations

import re
import runpy
from pathlib import Path
from typing import Any

import pytest
import yaml

from uw_visibility.config.parameters import ParameterInfo, describe
from uw_visibility.config.schema import CameraConfig, NodeConfig, PipelineConfig, read_yaml
from uw_visibility.errors import InputError

FILE = Path(__file__).resolve().parents[2] / "config" / "uw_visibility.yaml"
INFOS = [*describe(PipelineConfig), *describe(NodeConfig)]
REMEDY = "run `make parameters`"


def file_with(folder: Path, text: str) -> Path:
    path = folder / "parameters.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def test_the_shipped_file_names_every_parameter_and_no_other() -> None:
    named = {*read_yaml(FILE), "camera.transfer"}
    assert sorted(named) == sorted(info.name for info in INFOS), REMEDY
    # Only a user tells it: the node asks about images like video where nobody does.
    assert "camera.transfer" not in read_yaml(FILE)
    assert "# transfer: linear" in FILE.read_text(encoding="utf-8")


@pytest.mark.parametrize("info", INFOS, ids=lambda info: info.name)
def test_the_shipped_file_holds_default_unit_and_meaning(info: ParameterInfo) -> None:
    value = read_yaml(FILE).get(info.name, CameraConfig().transfer)
    assert value == plain(info.default), REMEDY
    assert type(value) is type(plain(info.default)), REMEDY
    # The comment may be wrapped anywhere.
    comments = re.findall(r"^ *# ?(.*)$", FILE.read_text(encoding="utf-8"), re.MULTILINE)
    text = " ".join(" ".join(comments).split())
    unit = f"{info.description} Unit: {info.unit}." if info.unit else info.description
    assert unit in text, REMEDY


def test_the_shipped_file_holds_no_name_twice() -> None:
    # YAML would let the second silently win over the first.
    node = yaml.compose(FILE.read_text(encoding="utf-8"))
    assert repeated_keys(node) == []


@pytest.mark.parametrize(("values", "says"), [
    ({"camera.vignetting": [-10.0, 0.0, 0.0]}, "camera.vignetting .* no light"),
    ({"camera.vignetting": [0.0, -8.0, 8.0]}, "camera.vignetting .* no light"),
    ({"survey.min_frames": 241}, "survey.min_frames is 241 and survey.max_frames 240"),
])
def test_parameters_that_cannot_work_together_are_refused(
    values: dict[str, Any], says: str
) -> None:
    with pytest.raises(InputError, match=says):
        PipelineConfig.from_parameters(values)
    # What a dark corner needs is allowed.
    PipelineConfig.from_parameters({"camera.vignetting": [-0.9, 0.0, 0.0]})


def repeated_keys(node: yaml.Node) -> list[str]:
    if not isinstance(node, yaml.MappingNode):
        return []
    keys = [key.value for key, _ in node.value]
    inside = [name for _, value in node.value for name in repeated_keys(value)]
    return [key for key in set(keys) if keys.count(key) > 1] + inside


def test_the_shipped_file_makes_the_default_configurations() -> None:
    assert PipelineConfig.from_yaml(FILE) == PipelineConfig()
    assert NodeConfig.from_parameters(read_yaml(FILE)) == NodeConfig()


def test_the_shipped_file_is_what_the_tool_writes() -> None:
    tool = runpy.run_path(str(FILE.parents[1] / "tools" / "write_parameters"))
    assert tool["render"]() == FILE.read_text(encoding="utf-8"), REMEDY


def test_every_parameter_has_a_meaning_and_every_number_has_bounds() -> None:
    for info in INFOS:
        assert info.description.endswith("."), info.name
        if info.type in (int, float, tuple):
            assert info.minimum is not None, info.name
            assert info.maximum is not None, info.name
        assert plain(info.check(info.default)) == plain(info.default)


def test_parameters_and_configuration_say_the_same() -> None:
    config = PipelineConfig.from_parameters({"stereo.max_disparity": 96})
    assert config.stereo.max_disparity == 96
    assert PipelineConfig.from_parameters(config.to_parameters()) == config


def test_the_pipeline_accepts_and_ignores_the_nodes_parameters() -> None:
    assert PipelineConfig.from_parameters({"rectify": True}) == PipelineConfig()
    assert NodeConfig.from_parameters({"rectify": True, "threads": 1}).rectify


@pytest.mark.parametrize(("gone", "near"), [
    ("warn_after", "warn_interval"), ("error_after", "error_interval"), ("bias_window", ""),
])
def test_a_file_with_a_parameter_that_is_gone_is_refused_in_a_sentence(
    tmp_path: Path, gone: str, near: str
) -> None:
    text = f"uw_visibility:\n  ros__parameters:\n    plausibility:\n      {gone}: 3\n"
    values = read_yaml(file_with(tmp_path, text))
    with pytest.raises(InputError, match=rf"^unknown parameter plausibility\.{gone}: .*{near}.*$"):
        NodeConfig.from_parameters(values)


def test_names_may_be_dotted_nested_and_under_any_node(tmp_path: Path) -> None:
    path = file_with(
        tmp_path,
        "/auv/uw_visibility:\n"
        "  ros__parameters:\n"
        "    stereo.max_disparity: 96\n"
        "    camera: {transfer: srgb}\n"
        "    qos_overrides./disparity.publisher.depth: 1\n"
        "    use_sim_time: false\n"
        "    start_type_description_service: true\n",
    )
    assert read_yaml(path) == {"stereo.max_disparity": 96, "camera.transfer": "srgb"}


@pytest.mark.parametrize(
    "text",
    ["", "just words", "stereo: {max_disparity: 1}", "/**: {ros__parameters: 1}", "a: [", "- 1"],
)
def test_a_file_of_another_form_is_refused_by_name(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match=r"parameters\.yaml"):
        read_yaml(file_with(tmp_path, text))


def test_a_missing_or_binary_file_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"absent\.yaml"):
        read_yaml(tmp_path / "absent.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(InputError, match=r"binary\.yaml"):
        read_yaml(tmp_path / "binary.yaml")
