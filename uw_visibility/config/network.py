# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of a network in ONNX, of one's own, in the place of a built-in part."""

from __future__ import annotations

from dataclasses import dataclass

from uw_visibility.config.parameters import parameter


@dataclass(frozen=True)
class NetworkConfig:
    """What a model in ONNX does not say of itself, and what runs it."""

    model: str = parameter(
        "", "Path of the network, an ONNX file; for matcher or restorer onnx only.",
    )
    providers: str = parameter(
        "cpu", "What runs the network: of tensorrt, cuda, openvino and cpu those wanted, with "
        "commas between them. An operator runs on the first that has it.",
    )
    pixel_values: str = parameter(
        "0..1", "Pixel values that the network takes, black to white; imagenet takes 0..1 less "
        "ImageNet's mean, over its standard deviation.",
        choices=("0..1", "0..255", "-1..1", "imagenet"),
    )
    size_multiple: int = parameter(
        32, "A network that takes any size gets images that are padded to multiples of this.",
        unit="px", minimum=1, maximum=512,
    )
    large_images: str = parameter(
        "resized", "Images that are larger than a model's fixed size are resized to it, or tiled: "
        "the network runs at full resolution on overlapping parts of that size.",
        choices=("resized", "tiled"),
    )
    time_limit: float = parameter(
        5.0, "A run of the network that takes longer is ended, and its frame is lost.",
        unit="s", minimum=0.01, maximum=600.0,
    )
    network_memory: float = parameter(
        0.5, "Memory of the computer, not of a device, that all networks of the process take at "
        "most; a network that needs more fails. The same in both sections.",
        unit="GiB", minimum=0.0625, maximum=256.0, read_only=True,
    )
