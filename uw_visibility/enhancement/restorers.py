# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Image restorers by name: that of the light model, and a network of one's own."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import EnhancementConfig
from uw_visibility.enhancement.radiance import Restorer
from uw_visibility.images.arrays import Mask, PerChannel, RangeMap
from uw_visibility.images.network import ONNX, Network, load
from uw_visibility.optics.light_model import Water


class OnnxRestorer:
    """Network (`EnhancementConfig.model`) in the place of `Restorer`; water and range are not used.

    Raises `InputError` if the model is missing or is not of this kind; see `Network`.
    """

    def __init__(self, config: EnhancementConfig, transfer: str, workers: Workers) -> None:
        self._config, self._threads = config, workers.threads
        load(config, "enhancement", 1, self._threads)
        self._network: tuple[tuple[int, int], Network] | None = None
        # Both views of a pair are restored at once.
        self._lock = threading.Lock()

    def restore(
        self, image: Any, range_map: RangeMap, water: Water, noise: PerChannel | None = None,
        known: Any = None, /,
    ) -> tuple[Any, Mask]:
        """Return the image as the network restores it; no pixel counts as limited.

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
"""Makers of restorers, of parameters, transfer and threads: another one is an entry here, with the
call `Restorer.restore`."""

RESTORER = EnhancementConfig.restorer
"""The default of the parameter `enhancement.restorer`, and the only one under lamps."""
