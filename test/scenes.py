# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Synthetic scenes for the tests: textures, stereo pairs of known disparity, water, reefs.

Everything is seeded: the same arguments give the same values.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from uw_visibility.config.schema import NodeConfig, PipelineConfig
from uw_visibility.enhancement.radiance import RestorationWater
from uw_visibility.messages.frames import StereoFrame
from uw_visibility.messages.processor import FrameProcessor
from uw_visibility.optics.light_model import attenuate, transmission
from uw_visibility.optics.transfer import from_linear
from uw_visibility.pipeline.result import FrameResult
from uw_visibility.stereo.rig import StereoRig
from uw_visibility_lab.simulation.camera import Pose, Sensor, StereoCamera
from uw_visibility_lab.simulation.frame import Effects, RenderedFrame, Renderer
from uw_visibility_lab.simulation.noise import noise_lattice
from uw_visibility_lab.simulation.scene import SPACING, Scene, reef
from uw_visibility_lab.simulation.shapes import SHAPE_COLUMNS
from uw_visibility_lab.simulation.water import Water

Image = NDArray[Any]

KAPPA = np.array([0.22776, 0.06641, 0.02455])
"""Attenuation of clear sea water as the default camera sees it, 1/m."""


def texture(
    shape: tuple[int, ...], seed: int = 0, scales: Sequence[int] = (1, 2, 4, 8)
) -> Image:
    """Contrast at several scales, stronger at the coarse ones; (H, W) or (H, W, 3), 0 .. 1."""
    rng = np.random.default_rng(seed)
    image = np.zeros(shape)
    for scale in scales:
        small = (shape[0] // scale + 2, shape[1] // scale + 2, *shape[2:])
        image += scale**0.5 * patches(rng.normal(size=small), scale)[: shape[0], : shape[1]]
    image -= image.min()
    return image / image.max()


def patches(values: ArrayLike, size: int) -> Image:
    """Repeat each value over a square of ``size`` pixels."""
    return np.asarray(values).repeat(size, axis=0).repeat(size, axis=1)


def restored_water(
    attenuation: Image, ambient_light: Image, scene_light: Image | None = None, **more: Any
) -> RestorationWater:
    """Water with one light for veil and scene, or with another for the scene."""
    light = ambient_light if scene_light is None else scene_light
    return RestorationWater(attenuation, ambient_light, light, **more)


def codes(image: Image, dtype: DTypeLike = np.uint8, transfer: str = "linear") -> Image:
    """Light 0 .. 1 as code values."""
    return from_linear(image, transfer, dtype)


def stereo_pair(wide: Image, disparity: ArrayLike, width: int | None = None) -> tuple[Image, Image]:
    """Show a wide picture to two cameras.

    Parameters
    ----------
    wide : (H, W', ...) ndarray
        What there is to see; its left part is the left image.
    disparity : float or (H,) array_like
        Disparity in px, of each row or of all; parts of a pixel are interpolated.
    width : int, optional
        Width of the images: by default what the largest disparity leaves.

    Returns
    -------
    left, right : (H, width, ...) ndarray
        The right image shows at column u − d what the left one shows at u.
    """
    rows = np.broadcast_to(np.asarray(disparity, dtype=float), wide.shape[0])
    if width is None:
        width = wide.shape[1] - int(np.ceil(rows.max()))
    columns = np.arange(width) + rows[:, np.newaxis]
    low = np.floor(columns).astype(int)
    high = np.minimum(low + 1, wide.shape[1] - 1)
    row = np.arange(wide.shape[0])[:, np.newaxis]
    part = (columns - low).reshape(*columns.shape, *(1,) * (wide.ndim - 2))
    right = wide[row, low]
    if part.any():
        right = (1 - part) * right + part * wide[row, high]
    return wide[:, :width].copy(), right


def in_water(
    radiance: Image,
    ranges: Image,
    attenuation: ArrayLike,
    ambient_light: ArrayLike,
    *,
    dtype: DTypeLike = np.uint8,
    transfer: str = "linear",
) -> Image:
    """See a scene of known ranges through water, as code values."""
    light = attenuate(
        np.asarray(radiance, np.float32), np.asarray(ranges, np.float32), attenuation,
        ambient_light,
    )
    return codes(light, dtype, transfer)


def row_ranges(rig: StereoRig, disparity: ArrayLike, width: int) -> Image:
    """Range of each pixel, (H, W) float32 in m, where each row has one disparity."""
    rows = np.asarray(disparity, np.float32)
    return rig.range_from_disparity(np.repeat(rows[:, np.newaxis], width, axis=1))


@dataclass
class WaterView:
    """Irradiance of a scene with black and white patches at every range.

    Attributes
    ----------
    irradiance : (H, W, 3) float32 ndarray
    range : (H, W) float32 ndarray
        m.
    attenuation, ambient_light : (3,) float64 ndarray
        The water.
    """

    irradiance: Image
    range: Image
    attenuation: Image
    ambient_light: Image

    def codes(self, dtype: DTypeLike = np.uint8) -> Image:
        """Return the irradiance as code values."""
        top = np.iinfo(np.dtype(dtype)).max
        return np.clip(self.irradiance * top + 0.5, 0, top).astype(dtype)


def water_view(
    alpha: float = 0.15, depth: float = 2.0, nearest: float = 1.0, farthest: float = 8.0,
    black: float = 0.1, brightest: float = 1.0, darkest: float = 0.0,
    size: tuple[int, int] = (360, 320), planes: int = 24, seed: int = 0,
) -> WaterView:
    """See patches of 8 px, a tenth of them black and a tenth white, over plain sand.

    Planes at steps of range lie side by side, so that each range bin has one range.
    """
    rng = np.random.default_rng(seed)
    shape = (size[0] // 8, size[1] // 8)
    value = rng.random((*shape, 3))
    kind = rng.random(shape)
    value[kind < black] = 0
    value[kind > 0.9] = 1
    value[2 * shape[0] // 3:] = 0.4
    rho = darkest + (brightest - darkest) * patches(value, 8)
    steps = np.linspace(nearest, farthest, planes)
    distance = np.repeat(steps, -(-size[1] // planes))[:size[1]]
    distance = np.tile(distance, (size[0], 1)).astype(np.float32)
    beta = KAPPA + alpha
    ambient = transmission(beta, depth)
    return WaterView(attenuate(rho, distance, beta, ambient), distance, beta, ambient)


@dataclass
class ReefView:
    """A camera over the rendered reef, which lies 1.5 m below and ahead.

    Attributes
    ----------
    camera : StereoCamera
    scene : Scene
    pose : Pose
    water : Water
    sensor, effects
        See `Renderer`.
    """

    camera: StereoCamera = StereoCamera()
    scene: Scene = field(default_factory=reef)
    pose: Pose = Pose((0.0, 0.0, 1.5), tilt=0.3)
    water: Water = Water(0.2, 3.0)
    sensor: Sensor = Sensor()
    effects: Effects = Effects()

    def frame(self, seed: int = 0, time: float = 0.0) -> RenderedFrame:
        """Render one frame."""
        renderer = Renderer(self.camera, self.sensor, self.effects)
        return renderer.render(self.scene, self.pose, self.water, seed=seed, time=time)


def blurred(image: Image, sigma: float) -> Image:
    """Blur as a lens does: texture from pixel to pixel would be measured as noise."""
    return cv2.GaussianBlur(image, (0, 0), sigma)


def processed(
    processor: FrameProcessor, frame: StereoFrame, config: PipelineConfig, node: NodeConfig,
    topics: Collection[str], **options: bool,
) -> tuple[FrameResult, dict[str, Any]]:
    """Result of one frame by itself, and its messages by topic."""
    work = processor.begin(frame, config)
    result = work.assess(topics, **options)
    return result, dict(work.messages(result, node, topics))


def flat_floor(seed: int = 0, *, texture: float = 1.0) -> Scene:
    """Flat floor of 12 m around the origin; from above it is a flat wall.

    texture: 1 for natural texture, 0 for none: one colour.
    """
    flat = np.zeros((round(12.0 / SPACING),) * 2, np.float32)
    return Scene(
        np.float32(texture) * noise_lattice(seed), flat, flat + 1, (-6.0, -6.0), 0.0, 0.0,
        np.zeros((0, SHAPE_COLUMNS)), np.zeros((0, 8)))
