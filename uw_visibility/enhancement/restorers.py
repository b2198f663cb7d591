# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Image restorers by name, and what the pipeline asks of one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import EnhancementConfig
from uw_visibility.enhancement.onnx_restorer import OnnxRestorer
from uw_visibility.enhancement.radiance import Restorer
from uw_visibility.images.arrays import Mask, PerChannel, RangeMap
from uw_visibility.images.network import ONNX
from uw_visibility.optics.light_model import Water


class ImageRestorer(Protocol):
    """Restorer of images; see `uw_visibility.enhancement.radiance.Restorer`, the first of them."""

    def restore(
        self, image: Any, range_map: RangeMap, water: Water, noise: PerChannel | None = None,
        known: Any = None, /,
    ) -> tuple[Any, Mask]:
        """Return the image without the water, and where it was restored by less than half."""


RESTORERS: dict[str, Callable[[EnhancementConfig, str, Workers], ImageRestorer]] = {
    "radiance": Restorer, ONNX: OnnxRestorer,
}
"""Makers of restorers, of parameters, transfer and threads: another one is an entry here."""

RESTORER = EnhancementConfig.restorer
"""The default of the parameter `enhancement.restorer`, and the only one under lamps."""
