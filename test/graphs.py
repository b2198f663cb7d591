# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Small graphs in ONNX for the tests, above all a matcher by shifts, and its twin in NumPy."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

WINDOW = 9
"""Side of the squares that differences are summed over, px."""
# A shift has no partner beyond the view; so much is worse than any match.
_BEYOND = 1e3
# All that the oldest supported onnxruntime reads.
_OPSET, _IR = 17, 8


def save(
    path: Path, nodes: Sequence[Any], weights: Sequence[Any] = (), *,
    inputs: dict[str, Sequence[Any]] | None = None, output: Sequence[Any] | None = None,
    outputs: Sequence[str] = ("disparity",), opsets: dict[str, int] | None = None,
    half: bool = False, **parts: Any,
) -> Path:
    """Write a graph of two images, "left" and "right", of any size by default."""
    from onnx import TensorProto, helper

    kind = TensorProto.FLOAT16 if half else TensorProto.FLOAT
    image = [1, 3, "height", "width"]
    named = inputs or {"left": image, "right": image}
    graph = helper.make_graph(
        nodes, "graph",
        [helper.make_tensor_value_info(name, kind, shape) for name, shape in named.items()],
        [helper.make_tensor_value_info(name, kind, output) for name in outputs],
        list(weights))
    opset_imports = [
        helper.make_opsetid(name, version)
        for name, version in {"": _OPSET, **(opsets or {})}.items()]
    model = helper.make_model(graph, opset_imports=opset_imports, ir_version=_IR, **parts)
    path.write_bytes(model.SerializeToString())
    return path


def shifts(
    path: Path, most: int = 40, *, channels_last: bool = False, channels: int = 3,
    size: tuple[Any, Any] = ("height", "width"), names: tuple[str, str] = ("left", "right"),
) -> Path:
    """Write a matcher: the shift of least mean difference around each pixel, up to `most` px."""
    from onnx import helper, numpy_helper

    weights = [
        numpy_helper.from_array(np.array(value), name) for name, value in (
            ("zero", [0]), ("three", [3]), ("beyond", np.float32(_BEYOND)), ("one", [1]))]
    nodes = []
    for name in names:
        image = name
        if channels_last:
            image = f"{name}_first"
            nodes.append(helper.make_node("Transpose", [name], [image], perm=[0, 3, 1, 2]))
        nodes.append(helper.make_node("ReduceMean", [image], [f"{name}_grey"], axes=[1]))
    left, right = (f"{name}_grey" for name in names)
    for d in range(most + 1):
        weights += [
            numpy_helper.from_array(np.array([0, 0, 0, d, 0, 0, 0, 0]), f"pad{d}"),
            numpy_helper.from_array(np.array([-d if d else 1 << 30]), f"end{d}")]
        nodes += [
            helper.make_node("Pad", [right, f"pad{d}", "beyond"], [f"wide{d}"]),
            helper.make_node("Slice", [f"wide{d}", "zero", f"end{d}", "three"], [f"right{d}"]),
            helper.make_node("Sub", [left, f"right{d}"], [f"difference{d}"]),
            helper.make_node("Abs", [f"difference{d}"], [f"cost{d}"])]
    half = WINDOW // 2
    nodes += [
        helper.make_node("Concat", [f"cost{d}" for d in range(most + 1)], ["costs"], axis=1),
        helper.make_node(
            "AveragePool", ["costs"], ["means"], kernel_shape=[WINDOW, WINDOW],
            pads=[half] * 4, count_include_pad=0),
        helper.make_node("ArgMin", ["means"], ["best"], axis=1, keepdims=1),
        helper.make_node("Cast", ["best"], ["disparity"], to=1)]
    shape = [1, *size, channels] if channels_last else [1, channels, *size]
    return save(path, nodes, weights, inputs=dict.fromkeys(names, shape))


def shifts_in_numpy(
    left: NDArray[np.floating], right: NDArray[np.floating], most: int = 40
) -> NDArray[np.float32]:
    """Return what the graph of `shifts` gives, of images (H, W, C), 0..1."""
    left, right = (np.float32(image).mean(axis=2) for image in (left, right))
    inside = cv2.blur(np.ones_like(left), (WINDOW, WINDOW), borderType=cv2.BORDER_CONSTANT)
    costs = []
    for d in range(most + 1):
        moved = np.full_like(right, _BEYOND)
        moved[:, d:] = right[:, : right.shape[1] - d]
        blurred = cv2.blur(
            np.abs(left - moved), (WINDOW, WINDOW), borderType=cv2.BORDER_CONSTANT)
        costs.append(blurred / inside)
    return np.argmin(costs, axis=0).astype(np.float32)
