# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Networks in ONNX: layouts, what is refused before anything runs, and how runs fail."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from graphs import save, shifts, shifts_in_numpy
from scenes import stereo_pair, texture

from uw_visibility.config.schema import NetworkConfig, PipelineConfig
from uw_visibility.errors import InputError
from uw_visibility.images.network import Network, NetworkError, check_content, digests

pytest.importorskip("onnx", reason="onnx is not installed")
pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")

import onnx
import onnxruntime
from onnx import TensorProto, helper, numpy_helper

SHAPE = (60, 90)
MOST = 12


def pair(channels: int = 3, disparity: float = 7.0) -> tuple[np.ndarray, np.ndarray]:
    wide = texture((SHAPE[0], SHAPE[1] + MOST, channels), seed=3)
    left, right = stereo_pair(wide, disparity, SHAPE[1])
    return np.float32(left), np.float32(right)


def network(path: Path, images: int = 2, shape: tuple[int, int] = SHAPE, **told: Any) -> Network:
    return Network(NetworkConfig(model=str(path), **told), "stereo", images, shape, 1)


def node(kind: str, inputs: list[str], output: str = "disparity", **told: Any) -> Any:
    return helper.make_node(kind, inputs, [output], **told)


def weight(value: Any, name: str) -> Any:
    return numpy_helper.from_array(np.asarray(value), name)


# The first channel of the left image: a map of the right shape.
FIRST = [node("Slice", ["left", "begin", "end", "axis"])]
BOUNDS = [weight([0], "begin"), weight([1], "end"), weight([1], "axis")]


@pytest.mark.parametrize("layout", [
    {}, {"channels_last": True}, {"channels": 1}, {"channels": 1, "channels_last": True},
    {"size": SHAPE}, {"size": (64, 128)}, {"size": (SHAPE[0], "width")}], ids=str)
def test_layout_and_size_are_read_from_the_model(tmp_path: Path, layout: dict[str, Any]) -> None:
    path = shifts(tmp_path / "shifts.onnx", MOST, **layout)
    left, right = pair(layout.get("channels", 3))
    found = network(path, size_multiple=16).run(left, right)
    assert found.shape == SHAPE
    # What the padding touches differs.
    inside = np.s_[:-5, :-5]
    np.testing.assert_array_equal(
        found[inside], shifts_in_numpy(left, right, MOST)[inside])
    assert (found[:, MOST:-8] == 7).mean() > 0.95


def test_images_beyond_a_fixed_size_are_resized(tmp_path: Path) -> None:
    made = network(shifts(tmp_path / "shifts.onnx", MOST, size=(SHAPE[0], SHAPE[1] // 2)))
    assert made.columns_per_px == 2.0
    found = made.columns_per_px * made.run(*pair())
    assert found.shape == SHAPE
    assert (np.abs(found[:, MOST:-8] - 7) <= 1).mean() > 0.9


@pytest.mark.parametrize("size", [(40, 56), (SHAPE[0], 40), (24, 200)], ids=str)
def test_tiles_of_a_fixed_size_find_what_the_whole_does(
    tmp_path: Path, size: tuple[int, int]
) -> None:
    """No seam is nearer to a border, or to what is not seen, than the graph's window."""
    config = NetworkConfig(
        str(shifts(tmp_path / "shifts.onnx", MOST, size=size)), large_images="tiled")
    made = Network(config, "stereo", 2, SHAPE, 1, MOST)
    assert made.columns_per_px == 1.0
    images = pair(disparity=MOST - 1.0)
    np.testing.assert_array_equal(
        made.run(*images)[:-5, MOST:-5], shifts_in_numpy(*images, MOST)[:-5, MOST:-5])


def test_tiles_need_room_for_the_disparities(tmp_path: Path) -> None:
    config = NetworkConfig(
        str(shifts(tmp_path / "shifts.onnx", MOST, size=(60, 40))), large_images="tiled")
    with pytest.raises(InputError, match=r"max_disparity to at most 20, or .*to resized"):
        Network(config, "stereo", 2, SHAPE, 1, 21)


@pytest.mark.parametrize("channels", [1, 3])
def test_tiles_of_images_are_blended(tmp_path: Path, channels: int) -> None:
    """A graph that adds a tile's mean has no step between tiles, one that keeps it is the same."""
    told = {"inputs": {"image": [1, channels, 20, 30]}}
    image = pair(3)[0][..., :channels]
    same = save(tmp_path / "same.onnx", [node("Identity", ["image"])], **told)
    got = network(same, 1, large_images="tiled").run(image)
    np.testing.assert_allclose(got, image[..., 0] if channels == 1 else image, atol=1e-5)
    mean = save(tmp_path / "mean.onnx", [
        node("ReduceMean", ["image"], "mean", axes=[2, 3]), node("Sub", ["image", "mean"], "none"),
        node("Sub", ["image", "none"])], **told)
    got = network(mean, 1, large_images="tiled").run(image)
    assert np.ptp(got) > 5 * np.abs(np.diff(got, axis=1)).max()


def test_left_and_right_are_told_by_their_names(tmp_path: Path) -> None:
    """A cost volume of exchanged images finds nothing."""
    path = shifts(tmp_path / "shifts.onnx", MOST)
    model = onnx.load(path)
    first = model.graph.input.pop(0)
    model.graph.input.append(first)
    onnx.save(model, path)
    np.testing.assert_array_equal(
        network(path).run(*pair())[:-5, :-5], shifts_in_numpy(*pair(), MOST)[:-5, :-5])


@pytest.mark.parametrize("values, wanted", [
    ("0..1", lambda x: x), ("0..255", lambda x: x), ("-1..1", lambda x: x),
    ("imagenet", lambda x: (x - [0.485, 0.456, 0.406]) / [0.229, 0.224, 0.225])])
def test_pixel_values_are_those_that_the_network_takes(
    tmp_path: Path, values: str, wanted: Callable[[Any], Any]
) -> None:
    """An image comes back in 0..1, but for ImageNet's, of which networks make 0..1 themselves."""
    path = save(
        tmp_path / "same.onnx", [node("Identity", ["image"])],
        inputs={"image": [1, 3, "h", "w"]})
    image, _ = pair()
    np.testing.assert_allclose(
        network(path, 1, pixel_values=values).run(image), wanted(image), atol=1e-5)


def test_pixel_values_reach_the_graph(tmp_path: Path) -> None:
    path = save(tmp_path / "first.onnx", FIRST, BOUNDS)
    left, right = pair()
    for values, low, high in (("0..1", 0, 1), ("0..255", 0, 255), ("-1..1", -1, 1)):
        np.testing.assert_allclose(
            network(path, pixel_values=values).run(left, right),
            low + (high - low) * left[..., 0], rtol=1e-5, atol=1e-5)


def test_the_normalisation_of_colours_is_refused_for_grey(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="pixel_values is imagenet, for RGB images"):
        network(shifts(tmp_path / "grey.onnx", channels=1), pixel_values="imagenet")


def test_half_precision_is_taken(tmp_path: Path) -> None:
    path = save(tmp_path / "first.onnx", FIRST, BOUNDS, half=True)
    left, right = pair()
    np.testing.assert_allclose(network(path).run(left, right), left[..., 0], atol=1e-3)


IMAGE = [1, 3, "h", "w"]


@pytest.mark.parametrize("told, says", [
    ({"inputs": {"left": IMAGE}}, "must have 2 of one layout"),
    ({"inputs": {"left": IMAGE, "right": IMAGE, "prior": IMAGE}}, "must have 2 of one layout"),
    ({"inputs": {"left": IMAGE, "right": [1, 1, "h", "w"]}}, "must have 2 of one layout"),
    ({"inputs": {"left": [1, 4, "h", "w"], "right": IMAGE}}, r"input left.*\[1, 4, 'h', 'w'\]"),
    ({"inputs": {"left": [2, 3, "h", "w"], "right": IMAGE}}, "must be float"),
    ({"inputs": {"left": ["n", "c", "h", "w"], "right": IMAGE}}, "must be float"),
    ({"inputs": {"left": [1, 3, 4, 3], "right": IMAGE}}, "must be float"),
    ({"inputs": {"left": [3, "h", "w"], "right": IMAGE}}, "must be float"),
    ({"inputs": {"left": [1, 3, 1 << 20, 8], "right": IMAGE}}, "at most 16384 px"),
    ({"outputs": ("disparity", "left")}, "must have 2 of one layout, and one output"),
], ids=str)
def test_models_of_another_shape_are_refused(
    tmp_path: Path, told: dict[str, Any], says: str
) -> None:
    inputs = told.get("inputs", {})
    path = save(
        tmp_path / "model.onnx",
        [node("Identity", ["left"], name) for name in told.get("outputs", ["disparity"])
         if name not in ("left", *inputs)]
        + ([node("Identity", ["right"], "left2")] if "outputs" in told else []),
        **{**told, "outputs": ("disparity", "left2") if "outputs" in told else ("disparity",)})
    with pytest.raises(InputError, match=says):
        network(path)


@pytest.mark.parametrize("nodes, says", [
    ([node("Identity", ["left"])], r"gave float32 of shape \(1, 3, 64, 96\): it must give float32"),
    ([node("ReduceMean", ["left"], axes=[1, 2])], "left-referenced disparity, px"),
    ([node("ReduceMean", ["left"], "mean", axes=[1]), node("Cast", ["mean"], to=6)], "gave int32"),
])
def test_outputs_of_another_shape_are_refused_when_it_is_tried(
    tmp_path: Path, nodes: list[Any], says: str
) -> None:
    path = save(tmp_path / "model.onnx", nodes)
    if "int32" in says:
        model = onnx.load(path)
        model.graph.output[0].type.tensor_type.elem_type = TensorProto.INT32
        onnx.save(model, path)
    with pytest.raises(InputError, match=says):
        network(path)


def test_external_data_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = shifts(tmp_path / "shifts.onnx", MOST)
    model = onnx.load(path)
    onnx.save(
        model, path, save_as_external_data=True, location="weights", size_threshold=0)
    with pytest.raises(InputError, match="weights in another file"):
        network(path)
    model = onnx.load(path, load_external_data=False)
    for each in model.graph.initializer:
        del each.external_data[:]
    onnx.save(model, path)
    with pytest.raises(InputError, match="weights in another file"):
        network(path)


@pytest.mark.parametrize("domain", ["com.microsoft", "mine", "ai.onnx.ml"])
def test_operators_of_other_domains_are_refused(tmp_path: Path, domain: str) -> None:
    """Within the branches of a condition, too."""
    odd = node("FusedConv", ["left"], "out", domain=domain)
    branch = helper.make_graph(
        [odd], "branch", [], [helper.make_tensor_value_info("out", TensorProto.FLOAT, None)])
    nodes = [node("If", ["yes"], then_branch=branch, else_branch=branch)]
    path = save(tmp_path / "odd.onnx", nodes, [weight(True, "yes")], opsets={domain: 1})
    with pytest.raises(InputError, match=f"operators of the domain {domain}"):
        network(path)


def test_functions_and_sparse_weights_are_refused(tmp_path: Path) -> None:
    function = helper.make_function(
        "", "Own", ["x"], ["y"], [node("Identity", ["x"], "y")], [helper.make_opsetid("", 17)])
    path = save(tmp_path / "own.onnx", [node("Own", ["left"])], functions=[function])
    with pytest.raises(InputError, match="functions of its own"):
        network(path)
    model = onnx.load(save(tmp_path / "sparse.onnx", FIRST, BOUNDS))
    model.graph.sparse_initializer.append(helper.make_sparse_tensor(
        helper.make_tensor("s", TensorProto.FLOAT, [1], [1.0]),
        helper.make_tensor("i", TensorProto.INT64, [1], [0]), [1 << 40]))
    with pytest.raises(InputError, match="sparse weights"):
        check_content(model.SerializeToString(), "sparse")


def test_sizes_are_compared_with_the_file_s(tmp_path: Path) -> None:
    model = onnx.load(save(tmp_path / "big.onnx", FIRST, BOUNDS))
    model.graph.initializer[0].dims[:] = [1 << 20, 1 << 20]
    with pytest.raises(InputError, match="1099511627776 elements"):
        check_content(model.SerializeToString(), "big")


def test_names_that_are_no_text_are_refused(tmp_path: Path) -> None:
    path = shifts(tmp_path / "shifts.onnx", MOST)
    path.write_bytes(path.read_bytes().replace(b"height", b"hei\xffht"))
    with pytest.raises(InputError, match=r"shifts\.onnx cannot be loaded"):
        network(path)


SMALL = """
import sys
from uw_visibility.config.schema import NetworkConfig
from uw_visibility.errors import InputError
from uw_visibility.images import network as module

try:
    module.Network(
        NetworkConfig(sys.argv[1], network_memory=0.25), "stereo", 2, (60, 90), 1)
except InputError as error:
    print(error)
"""


@pytest.mark.parametrize("constant", [True, False])
def test_memory_is_bounded(tmp_path: Path, constant: bool) -> None:
    """Of constants that loading would compute, and of tensors of a run: 1 GiB of 256 MiB."""
    if constant and onnxruntime.__version__.startswith("1.17."):
        pytest.skip("onnxruntime 1.17 computes constants beyond the bound when it loads a model")
    nodes = [
        node("ConstantOfShape", ["shape"], "many") if constant
        else node("Expand", ["left", "shape"], "many"),
        node("ReduceSum", ["many"], "sum", keepdims=0), node("Add", ["left", "sum"])]
    shape = weight([1 << 28] if constant else [1 << 14, 1, 1, 1], "shape")
    path = save(tmp_path / "big.onnx", nodes, [shape])
    run = subprocess.run(
        [sys.executable, "-c", SMALL, path], capture_output=True, text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}, check=True)
    assert "big.onnx" in run.stdout
    assert "Available memory" in run.stdout
    if not constant:
        assert "increase stereo.network_memory" in run.stdout


def test_networks_of_a_process_share_one_bound(tmp_path: Path) -> None:
    path = shifts(tmp_path / "shifts.onnx", MOST)
    network(path)
    with pytest.raises(InputError, match=r"network_memory is 1 GiB.*have 0\.5 GiB"):
        network(path, network_memory=1.0)


def test_values_that_are_not_finite_fail(tmp_path: Path) -> None:
    """But for those of the blank images that it is tried with: 0/0 here."""
    nodes = [node("Slice", ["left", "begin", "end", "axis"], "first"),
             node("Sub", ["first", "first"], "none"), node("Div", ["none", "none"])]
    made = network(save(tmp_path / "nan.onnx", nodes, BOUNDS))
    with pytest.raises(NetworkError, match="values that are NaN or infinite"):
        made.run(*pair())


def slow(path: Path) -> Path:
    """Write a graph that counts up to 1e9 if the left image is not black."""
    body = helper.make_graph(
        [helper.make_node("Identity", ["go"], ["on"]),
         helper.make_node("Add", ["x", "x"], ["y"])], "body",
        [helper.make_tensor_value_info("i", TensorProto.INT64, []),
         helper.make_tensor_value_info("go", TensorProto.BOOL, []),
         helper.make_tensor_value_info("x", TensorProto.FLOAT, None)],
        [helper.make_tensor_value_info("on", TensorProto.BOOL, []),
         helper.make_tensor_value_info("y", TensorProto.FLOAT, None)])
    nodes = [
        node("Slice", ["left", "begin", "end", "axis"], "first"),
        node("ReduceMax", ["left"], "most", keepdims=0), node("Cast", ["most"], "lit", to=9),
        node("Loop", ["rounds", "lit", "first"], body=body)]
    return save(path, nodes, [*BOUNDS, weight(10**9, "rounds")])


def test_a_run_that_takes_too_long_is_ended(tmp_path: Path) -> None:
    made = network(slow(tmp_path / "slow.onnx"), time_limit=0.2)
    with pytest.raises(NetworkError, match=r"took longer than stereo.time_limit, 0.2 s"):
        made.run(*pair())
    # It can be asked again.
    made.run(*np.zeros((2, *SHAPE, 3), np.float32))


@pytest.mark.parametrize("told, says", [
    ({"providers": "tensorrt"}, "providers names 'tensorrt': this onnxruntime has cpu"),
    ({"providers": "cpu,tpu"}, "providers names 'tpu'"),
    ({"model": ""}, "stereo.model is empty"),
    ({"model": "/nowhere/model.onnx"}, "cannot read model /nowhere/model.onnx")])
def test_what_cannot_be_run_is_named(tmp_path: Path, told: dict[str, Any], says: str) -> None:
    told = {"model": str(save(tmp_path / "first.onnx", FIRST, BOUNDS)), **told}
    with pytest.raises(InputError, match=says):
        Network(NetworkConfig(**told), "stereo", 2, SHAPE, 1)


def test_without_onnxruntime_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(InputError, match=r"needs onnxruntime: .*uw_visibility\[onnx\]"):
        network(save(tmp_path / "first.onnx", FIRST, BOUNDS))


def test_the_digest_is_that_of_the_file_as_it_is_now(tmp_path: Path) -> None:
    path = tmp_path / "model.onnx"
    config = PipelineConfig.from_parameters({"stereo.matcher": "onnx", "stereo.model": str(path)})
    found = set()
    for content in (b"a", b"bc"):
        path.write_bytes(content)
        found.add(digests(config)["stereo.model_sha256"])
    assert len(found) == 2
    assert digests(config.built_in()) == {}


DAMAGE = """
import json, random, resource, sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from faults.mutations import mutate
from uw_visibility.config.schema import NetworkConfig
from uw_visibility.errors import InputError
from uw_visibility.images import network as module
import numpy as np

content = Path("whole.onnx").read_bytes()
images = np.random.default_rng(0).random((2, 60, 90, 3), np.float32)
counts = {"refused": 0, "ran": 0}
for seed in range(150):
    Path("damaged.onnx").write_bytes(mutate(content, random.Random(seed))[1])
    try:
        config = NetworkConfig("damaged.onnx", time_limit=5.0)
        made = module.Network(config, "stereo", 2, (60, 90), 1)
        made.run(*images)
        counts["ran"] += 1
    except InputError as error:
        assert len(str(error)) > 20
        counts["refused"] += 1
counts["memory"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(json.dumps(counts))
"""


def test_damaged_models_are_refused_or_run_and_nothing_else_happens(tmp_path: Path) -> None:
    """Names and numbers that damage leaves valid make another graph, which may run."""
    shifts(tmp_path / "whole.onnx", MOST)
    before = {*tmp_path.iterdir(), tmp_path / "damaged.onnx"}
    tests = Path(__file__).resolve().parents[1]
    run = subprocess.run(
        [sys.executable, "-c", DAMAGE, tests], cwd=tmp_path, capture_output=True, text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}, check=False)
    assert run.returncode == 0, run.stderr
    # Old versions of onnxruntime print before it.
    counts = json.loads(run.stdout.splitlines()[-1])
    assert counts["refused"] > 75
    assert counts["refused"] + counts["ran"] == 150
    # kB.
    assert counts["memory"] < 1 << 20
    assert {*tmp_path.iterdir()} == before
