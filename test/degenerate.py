# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Degenerate stereo pairs: lost channels, one code value, lit rows, noise, and their mixtures.

`pictures` draws them for hypothesis, `Picture.random` by a seed for the fuzzer. What an
estimate may say of any of them, `absurdity` tells.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray
from scenes import stereo_pair

from uw_visibility import Pipeline, PipelineConfig, estimate_water
from uw_visibility.errors import InputError
from uw_visibility.images.chroma import code_value
from uw_visibility.optics.transfer import from_linear
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.meaning.assessment import Visibility
from uw_visibility.water.series.filter import WaterFilter

Image = NDArray[Any]

FOCAL_LENGTH, BASELINE = 400.0, 0.12
TRANSFERS = ("linear", "srgb")
GROUNDS = ("texture", "fine", "stripes", "flat")


def _set(channel: int, code: float) -> Callable[[Image, Any], None]:
    def spoil(image: Image, _: Any) -> None:
        image[..., channel] = round(code * np.iinfo(image.dtype).max)

    return spoil


def _lose(channel: int) -> Callable[[Image, Any], None]:
    """Leave noise of a code or none, as where water took the light."""
    def spoil(image: Image, rng: Any) -> None:
        image[..., channel] = rng.integers(0, 2, image.shape[:2]) * code_value(image)

    return spoil


def _alike(image: Image, _: Any) -> None:
    image[..., 1] = image[..., 2]


def _row(image: Image, rng: Any) -> None:
    image[rng.integers(image.shape[0])] = np.iinfo(image.dtype).max


def _column(image: Image, rng: Any) -> None:
    image[:, rng.integers(image.shape[1])] = np.iinfo(image.dtype).max


def _only_a_row(image: Image, rng: Any) -> None:
    row = int(rng.integers(image.shape[0]))
    image[:row] = 0
    image[row + 1:] = 0


def _one_code(image: Image, rng: Any) -> None:
    image[:] = rng.integers(np.iinfo(image.dtype).max + 1)


def _noise(image: Image, rng: Any) -> None:
    image[:] = rng.integers(0, np.iinfo(image.dtype).max + 1, image.shape)


def _dim(image: Image, rng: Any) -> None:
    image[:] = image // int(rng.integers(8, 200))


def _bright(image: Image, _: Any) -> None:
    largest = int(np.iinfo(image.dtype).max)
    image[:] = np.minimum(image.astype(np.int64) * 6, largest)


def _two_codes(image: Image, _: Any) -> None:
    half = np.iinfo(image.dtype).max // 2
    image[:] = np.where(image > half // 2, half, 0)


def _hot_pixel(image: Image, rng: Any) -> None:
    image[rng.integers(image.shape[0]), rng.integers(image.shape[1])] = np.iinfo(image.dtype).max


def _black_half(image: Image, _: Any) -> None:
    image[:, : image.shape[1] // 2] = 0


DEFECTS: dict[str, Callable[[Image, Any], None]] = {
    **{f"{name} 0": _set(c, 0.0) for c, name in enumerate(("red", "green", "blue"))},
    **{f"{name} lost": _lose(c) for c, name in enumerate(("red", "green", "blue"))},
    "red constant": _set(0, 0.3), "blue constant": _set(2, 0.5), "green saturated": _set(1, 1.0),
    "two channels alike": _alike, "a row lit": _row, "a column lit": _column,
    "nothing but a row": _only_a_row, "one code": _one_code, "all noise": _noise, "dim": _dim,
    "bright": _bright, "two codes": _two_codes, "hot pixel": _hot_pixel, "black half": _black_half,
}


@dataclass(frozen=True)
class Picture:
    """A stereo pair under water, of which something is degenerate.

    Attributes
    ----------
    height, width : int
        px.
    bits : int
        8 or 16.
    grey : bool
        Whether the images are (H, W).
    transfer : str
    ground : str
        One of `GROUNDS`.
    attenuation : float
        1/m, of the clearest channel.
    open_water : float
        Part of the image, above, in which nothing but water is seen.
    defects : tuple of str
        Names of `DEFECTS`, in the order in which they are applied to both images alike.
    right : str
        "" for a right image of the same scene, "other" for one of another scene.
    seed : int
    """

    height: int
    width: int
    bits: int
    grey: bool
    transfer: str
    ground: str
    attenuation: float
    open_water: float
    defects: tuple[str, ...]
    right: str
    seed: int

    @classmethod
    def random(cls, seed: int, largest: int = 320) -> Picture:
        """Draw a picture by a seed, with sides of 96 to ``largest`` px."""
        rng = np.random.default_rng(seed)
        names = sorted(DEFECTS)
        return cls(
            int(rng.integers(96, max(largest * 3 // 4, 97))), int(rng.integers(96, largest + 1)),
            int(rng.choice((8, 16))), bool(rng.random() < 0.1), str(rng.choice(TRANSFERS)),
            str(rng.choice(GROUNDS)), float(rng.uniform(0.03, 0.6)),
            float(rng.choice((0.0, 0.0, 0.2, 0.5))),
            tuple(str(n) for n in rng.choice(names, int(rng.integers(0, 4)), replace=False)),
            str(rng.choice(("", "", "", "other"))), seed)

    @property
    def rig(self) -> StereoRig:
        """Rig of the pair."""
        return StereoRig(FOCAL_LENGTH, BASELINE, ((self.width - 1) / 2, (self.height - 1) / 2))

    def make(self) -> tuple[Image, Image, NDArray[np.float32]]:
        """Left and right image, and the left one's disparity, px; NaN in open water."""
        # A floor that comes nearer downwards.
        rows = np.linspace(0.03 * self.width, 0.18 * self.width, self.height)
        left, right = self._see(self.seed, rows)
        if self.right == "other":
            right, _ = self._see(self.seed + 1, rows)
        for name in self.defects:
            # The same rows and pixels in both, noise of their own.
            for side, image in enumerate((left, right)):
                own = name.endswith(("lost", "noise"))
                DEFECTS[name](image, np.random.default_rng(self.seed + 2 + (side if own else 0)))
        disparity = np.repeat(rows[:, np.newaxis], self.width, 1).astype(np.float32)
        disparity[: round(self.open_water * self.height)] = np.nan
        if self.grey:
            left, right = (np.ascontiguousarray(image[..., 1]) for image in (left, right))
        return left, right, disparity

    def _see(self, seed: int, rows: Image) -> list[Image]:
        """Both views of one ground through the water."""
        radiance = self._ground(
            np.random.default_rng(seed), self.width + math.ceil(rows.max()) + 1)
        distance = FOCAL_LENGTH * BASELINE / rows
        beta = self.attenuation * np.array((2.5, 1.2, 1.0))
        light, veil = np.array((0.4, 0.8, 0.9)), np.array((0.2, 0.4, 0.5))
        kept = np.exp(-beta * distance[:, np.newaxis])[:, np.newaxis]
        views = []
        for seen in stereo_pair(radiance, rows, self.width):
            image = light * seen * kept + veil * (1 - kept)
            image[: round(self.open_water * self.height)] = veil
            dtype = np.uint8 if self.bits == 8 else np.uint16
            views.append(from_linear(image.astype(np.float32), self.transfer, dtype))
        return views

    def _ground(self, rng: Any, wide: int) -> Image:
        shape = (self.height, wide)
        if self.ground == "flat":
            return np.full((*shape, 3), 0.5)
        if self.ground == "stripes":
            # 1 px wide.
            return np.repeat(rng.integers(0, 2, (1, wide, 1)) * 0.8, self.height, 0).repeat(3, 2)
        image = rng.random((*shape, 3))
        if self.ground == "texture":
            coarse = rng.random((self.height // 8 + 2, wide // 8 + 2, 3))
            image = 0.3 * image + 0.7 * cv2.resize(coarse, shape[::-1])
        return np.asarray(np.clip(1.6 * image - 0.3, 0.0, 1.0))


@st.composite
def pictures(draw: st.DrawFn, largest: int = 240) -> Picture:
    """Degenerate pictures for hypothesis."""
    return Picture(
        height=draw(st.integers(96, max(largest * 3 // 4, 97))),
        width=draw(st.integers(160, max(largest, 161))),
        bits=draw(st.sampled_from((8, 16))),
        grey=draw(st.sampled_from((False, False, False, True))),
        transfer=draw(st.sampled_from(TRANSFERS)),
        ground=draw(st.sampled_from(GROUNDS)),
        attenuation=draw(st.sampled_from((0.03, 0.1, 0.3, 0.6))),
        open_water=draw(st.sampled_from((0.0, 0.2, 0.5))),
        defects=tuple(draw(st.lists(st.sampled_from(sorted(DEFECTS)), max_size=3, unique=True))),
        right=draw(st.sampled_from(("", "", "other"))),
        seed=draw(st.integers(0, 1 << 16)),
    )


def absurdity(
    water: WaterEstimate, visibility: Visibility, clear_water: NDArray[np.float64]
) -> str:
    """Say what is absurd about an estimate; nothing where it is one or says why it is none."""
    known = np.isfinite(water.attenuation)
    told = [
        ("attenuation", water.attenuation[known], water.attenuation_stddev[known]),
        ("veil", water.veil[known], water.ambient_light_stddev[known]),
        ("distance", visibility.distance, visibility.distance_stddev),
        ("depth", visibility.depth, visibility.depth_stddev),
    ]
    for name, value, stddev in told:
        value, stddev = np.atleast_1d(value), np.atleast_1d(stddev)
        if (np.isnan(value) != np.isnan(stddev)).any() or np.isinf(value).any():
            return f"{name}: {value} with a standard deviation of {stddev}"
        if (value < 0).any() or (stddev < 0).any():
            return f"{name} is negative: {value}, {stddev}"
    if str(water.status) == "ok" and not known.any():
        return "ok without any attenuation"
    if str(visibility.status) == "ok" and not math.isfinite(visibility.distance):
        return "ok without a distance"
    if str(visibility.depth_status) == "ok" and not math.isfinite(visibility.depth):
        return "ok without a depth"
    # Water is not clearer than the clearest, but for what three sigma allow.
    least = water.attenuation + 3 * water.attenuation_stddev
    if (least[known] < clear_water[known]).any():
        return f"clearer than clear water: {water.attenuation}"
    return ""


def examine(picture: Picture) -> str:
    """Process a picture in every way; say what the pipeline refuses, if it does.

    Raises
    ------
    AssertionError
        If something absurd is told.
    """
    config = PipelineConfig.from_parameters({"camera.transfer": picture.transfer, "threads": 1})
    left, right, disparity = picture.make()
    found = estimate_water(left, disparity, picture.rig, config)
    clear = found.clear_water_attenuation
    assert absurdity(found.water, found.visibility, clear) == ""
    try:
        result = Pipeline(picture.rig, config).process(left, right)
    except InputError as error:
        assert str(error).isprintable()
        return str(error)
    assert absurdity(result.water, result.visibility, clear) == ""
    assert not np.isinf(result.disparity).any()
    assert result.left_enhanced.shape == left.shape
    seen = WaterFilter(config)
    for stamp in (1.0, 1.1, 1.2):
        filtered = seen.update(result.water, stamp, picture.rig)
        assert absurdity(filtered.water, filtered.visibility, clear) == ""
    return ""
