# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Image restorers by name: the light model's, and a user's network."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import EnhancementConfig
from uw_visibility.enhancement.radiance import RestorationWater, Restorer
from uw_visibility.images.arrays import Mask, PerChannel, RangeMap
from uw_visibility.images.network import ONNX, Network, load


class OnnxRestorer:
    """Network (`EnhancementConfig.model`) with `Restorer`'s interface; ignores water and range.

    Raises `InputError` if the model is missing or unsuitable, see `Network`.
    """

    def __init__(self, config: EnhancementConfig, transfer: str, workers: Workers) -> None:
        self._config, self._threads = config, workers.threads
        load(config, "enhancement", 1, self._threads)
        self._network: tuple[tuple[int, int], Network] | None = None
        # The views of a pair are restored in parallel threads.
        self._lock = threading.Lock()

    def restore(
        self, image: Any, range_map: RangeMap, water: RestorationWater,
        noise: PerChannel | None = None, known: Any = None, /,
    ) -> tuple[Any, Mask]:
        """Return the image restored by the network, and an empty mask of limited pixels.

        Raises `uw_visibility.images.network.NetworkError` if the network fails.
        """
        with self._lock:
            shape = image.shape[:2]
            if self._network is None or self._network[0] != shape:
                self._network = (
                    shape, Network(self._config, "enhancement", 1, shape, self._threads))
            network = self._network[1]
            white = np.iinfo(image.dtype).max
            made = network.run(network.channels_of(image / np.float32(white)))
        if made.ndim > image.ndim:
            made = made.mean(axis=2)
        elif made.ndim < image.ndim:
            made = np.repeat(made[..., np.newaxis], 3, axis=2)
        restored = (np.clip(made, 0, 1) * white + 0.5).astype(image.dtype)
        return restored, np.zeros(shape, np.bool_)


RESTORERS: dict[str, Callable[[EnhancementConfig, str, Workers], Restorer | OnnxRestorer]] = {
    "radiance": Restorer, ONNX: OnnxRestorer,
}
"""Factories of restorers, called with parameters, transfer and threads. A further restorer needs an
entry here and a method like `Restorer.restore`."""

RESTORER = EnhancementConfig.restorer
"""Default of the parameter `enhancement.restorer`, and the only restorer under lamps."""
