# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Random underwater views of a scene, with ground truth."""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array, Map, Mask
from uw_visibility_lab.simulation.formation import fit_attenuation
from uw_visibility_lab.worlds import beliefs as believed
from uw_visibility_lab.worlds.beliefs import count, happens
from uw_visibility_lab.worlds.beliefs import draw as drawn
from uw_visibility_lab.worlds.camera import draw_curve, record, told_linear
from uw_visibility_lab.worlds.lamps import light_by_lamps
from uw_visibility_lab.worlds.ranging import measure_ranges
from uw_visibility_lab.worlds.scenes import SIZE, Scene, directions
from uw_visibility_lab.worlds.water import PATHS, Water, draw_water

EFFECTS: tuple[str, ...] = tuple(
    name.partition(".")[2] for name in believed.beliefs()
    if name.startswith(("effects.", "always.")) and name != "effects.plain")
"""Names of departures from the light model, a linear camera and exact ranges."""

# Tangent of half a field of view of 53 degrees, for caustics only.
_ACROSS = 0.5
# Number of ranges in lookup tables of band averages.
_LOOKUP = 1024
# Effects that exclude one another: the second is left out if the first is active.
_EXCLUDING = (
    ("low light", "over-exposure"), ("jpeg", "16 bit"), ("grey", "red gone"),
    ("grey", "white balance"), ("grey", "grey world"))
# Factor of a large particle's total light: a blur of 1.5 px spreads it over 14 px.
_SPREAD = 12.0
# The near and the far part of a halo are blurred at resolutions reduced by these factors.
_HALO_STEPS = (4, 16)
# Least share of surfaces in a cropped view.
_LEAST_SURFACE = 0.05


class Streams:
    """Random numbers by purpose: the draws of one effect do not change those of others.

    So a view without an effect is otherwise the same view.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        self._seed = int(rng.integers(1 << 62))

    def __call__(self, purpose: str) -> np.random.Generator:
        return np.random.default_rng([self._seed, zlib.crc32(purpose.encode())])


@dataclass(frozen=True)
class View:
    """An underwater image, the parameters declared with it, and the truth."""

    image: NDArray[Any]  # (H, W, 3) uint8 or uint16; RGB code values
    ranges: Map  # (H, W) float32; as measured, m along the line of sight; NaN where unknown
    # declared standard deviation of range over range², 1/m; 0 for exact ranges
    range_error: float
    transfer: str  # declared: ``linear`` or ``srgb``
    clear_water: Array  # (3,); declared κ, 1/m
    # (3,); true β, 1/m, of surfaces' light; where it varies, the best fit of e^(−βd) to the
    # transmission over the ranges in view
    attenuation: Array
    # veil, light: (3,); true B and W, means over the view, in units of the image when linearised
    # by the declared transfer
    veil: Array
    light: Array
    depth: float  # of the camera, m
    open_water: Mask  # (H, W); pixels that show water only
    effects: tuple[str, ...]  # active ones of `EFFECTS`
    scene: str  # its name
    curve: str  # name of the camera's true curve


def draw(
    rng: np.random.Generator,
    scene: Scene,
    *,
    effects: Sequence[str] | None = None,
    nearer: float = 1.0,
    lamps: bool = False,
) -> View:
    """Draw a random view of a scene under water, of the scene's size.

    E = W ρ e^(−βd) + B (1 − e^(−βd)), changed by the effects (Akkaynak and Treibitz 2018, doi
    10.1109/CVPR.2018.00703).

    rng: source of all values; the same state gives the same view.
    effects: active ones of `EFFECTS`; None draws them by their beliefs.
    nearer: factor of the drawn median range. With the same state, another scene and another factor
        give another frame of the same water by the same camera.
    lamps: lamps of the vehicle light the view instead of daylight; `veil` and `light` are not valid
        then.
    """
    if not np.isfinite(scene.range).any():
        raise InputError(f"scene {scene.name} shows no surface: give one with finite ranges")
    streams = Streams(rng)
    names = _choose(streams("effects"), effects)
    reflectance, ranges, heights = vary(streams("scene"), scene)
    height, width = ranges.shape
    if "open water" in names:
        if np.isfinite(ranges).all():
            ranges = _open(streams("open water"), ranges)
        else:
            names = tuple(name for name in names if name != "open water")
    if "board" in names:
        _add_board(streams("board"), reflectance, ranges)
    if "fish" in names:
        _add_fish(streams("fish"), reflectance, ranges)
    known = np.isfinite(ranges)
    water = draw_water(
        streams("water"), spectrum="spectrum" in names, red_gone="red gone" in names)
    median = drawn(streams("distance"), "scene.distance")
    # No pictures are taken where even the clearest channel loses all light.
    path = drawn(streams("path"), "water.most_path")
    median = min(median, path / float(water.attenuation.min()))
    median *= nearer
    ranges *= np.float32(median / float(np.median(ranges[known])))

    thicker = _thicker(streams, names, ranges, heights, median)
    transmission, unveiled, attenuation = _transmissions(
        streams("veil coefficient"), names, water, ranges, thicker)
    light = water.light
    veil = light * water.ratio
    if lamps:
        direct, irradiance = light_by_lamps(
            streams("lamps"), reflectance, ranges, water.attenuation)
        light = direct[known].max(axis=0).astype(np.float64)
    else:
        rows = np.linspace(1.0, -1.0, height, dtype=np.float32)[:, np.newaxis, np.newaxis]
        columns = np.linspace(-1.0, 1.0, width, dtype=np.float32)[np.newaxis, :, np.newaxis]
        direct = reflectance
        direct *= light.astype(np.float32)
        direct *= transmission
        light_map = _light_map(streams, names, water, ranges, heights, rows, columns)
        if light_map is not None:
            direct *= light_map
            light = light * light_map[known].mean(axis=0, dtype=np.float64)
        irradiance = np.float32(1.0) - unveiled
        irradiance *= veil.astype(np.float32)
        if "veil gradient" in names:
            sloping = streams("veil gradient")
            veil_map = np.maximum(
                1.0 + np.float32(drawn(sloping, "veil.gradient")) * rows
                + np.float32(drawn(sloping, "veil.gradient_across")) * columns, 0.2,
            ).astype(np.float32)
            irradiance *= veil_map
            veil = veil * veil_map.mean(axis=(0, 1), dtype=np.float64)
    if "halo" in names:
        direct = _add_halo(streams("halo"), direct, ranges, water.forward)
    if "forward scatter" in names:
        direct = scatter_forward(streams("forward scatter"), direct, transmission)
    irradiance += direct
    if "snow" in names:
        _add_snow(streams("snow"), irradiance, light)
    if "defocus" in names:
        sigma = drawn(streams("defocus"), "camera.defocus") * height / SIZE[0]
        irradiance = cv2.GaussianBlur(irradiance, (0, 0), sigma)
    if "grey" in names:
        irradiance, attenuation, veil, light = _grey(
            irradiance, attenuation, veil, light, ranges[known])

    gains = _balance(streams, names, irradiance)
    strength = _exposure(streams("exposure"), names)
    top = float(np.quantile((irradiance[::4, ::4] * gains.astype(np.float32)).max(-1), 0.995))
    gains_all = gains * (strength / max(top, 1e-12))
    irradiance *= gains_all.astype(np.float32)
    if "red gone" in names:
        # Below black: the remaining light is below the camera's black level.
        irradiance[..., 0] = -1.0
    curve, told = draw_curve(streams("curve"), names)
    image = record(streams, irradiance, gains, curve, names)
    measured, error = measure_ranges(streams, ranges, image, names)
    return View(
        image=image, ranges=measured, range_error=error, transfer=told,
        clear_water=water.clear_water, attenuation=attenuation,
        veil=told_linear(curve, told, veil * gains_all),
        light=told_linear(curve, told, light * gains_all),
        depth=water.depth, open_water=~known, effects=names, scene=scene.name, curve=curve.name)


def _choose(rng: np.random.Generator, given: Sequence[str] | None) -> tuple[str, ...]:
    """Draw the effects, or check those that are given."""
    if given is not None:
        for name in given:
            if name not in EFFECTS:
                raise InputError(f"no effect {name!r}: give some of {', '.join(EFFECTS)}")
        return tuple(name for name in EFFECTS if name in given)
    plain = happens(rng, "effects.plain")
    found = []
    for name in EFFECTS:
        # Drawn for plain views, too, so that later draws of the seed do not change.
        always = f"always.{name}" in believed.beliefs()
        there = happens(rng, f"always.{name}" if always else f"effects.{name}")
        if there and (always or not plain):
            found.append(name)
    for first, second in _EXCLUDING:
        if first in found and second in found:
            found.remove(second)
    return tuple(found)


def vary(rng: np.random.Generator, scene: Scene) -> tuple[Map, Map, Map]:
    """Crop, mirror and vary a scene: its reflectance, ranges, and `downward`."""
    height, width = scene.range.shape
    pitch = scene.pitch
    if math.isnan(pitch):
        pitch = math.radians(drawn(rng, "camera.pitch"))
    focal = scene.focal_length
    if math.isnan(focal):
        focal = drawn(rng, "camera.focal_length")
    down = downward(scene.range.shape, focal * width, pitch, scene.roll)
    reflectance, ranges = scene.reflectance.astype(np.float32), scene.range.astype(np.float32)
    if happens(rng, "scene.crop_share"):
        share = drawn(rng, "scene.crop")
        rows, columns = round(height * share), round(width * share)
        top, left = rng.integers(height - rows + 1), rng.integers(width - columns + 1)
        window = np.s_[top:top + rows, left:left + columns]
        part = ranges[window]
        # Not if the part shows hardly anything but open water.
        if np.isfinite(part).mean() > _LEAST_SURFACE:
            size = (width, height)
            reflectance = cv2.resize(reflectance[window], size, interpolation=cv2.INTER_LINEAR)
            # No interpolation: there is no surface between a near and a far one.
            ranges = cv2.resize(part, size, interpolation=cv2.INTER_NEAREST)
            down = cv2.resize(down[window], size, interpolation=cv2.INTER_LINEAR)
    if happens(rng, "scene.mirror"):
        reflectance, ranges, down = (x[:, ::-1] for x in (reflectance, ranges, down))
    if happens(rng, "scene.exchange_channels"):
        reflectance = reflectance[..., rng.permutation(3)]
    if happens(rng, "scene.exponent_share"):
        known = np.isfinite(ranges)
        median = np.float32(np.median(ranges[known])) if known.any() else np.float32(1.0)
        ranges = median * cv2.pow(
            np.where(known, ranges, median) / median, drawn(rng, "scene.distance_exponent"))
        ranges[~known] = np.inf
    reflectance = cv2.pow(np.ascontiguousarray(reflectance), drawn(rng, "scene.exponent"))
    top_value = float(np.quantile(reflectance[::4, ::4], 0.99))
    if happens(rng, "scene.dull"):
        low, high = drawn(rng, "scene.dull_low"), drawn(rng, "scene.dull_high")
        reflectance = np.float32(low) + np.minimum(
            reflectance * np.float32((high - low) / max(top_value, 1e-3)), np.float32(high - low))
    else:
        name = "scene.dark_gain" if happens(rng, "scene.dark") else "scene.gain"
        reflectance *= np.float32(drawn(rng, name) / max(top_value, 0.5))
    return np.minimum(reflectance, 1.0), np.array(ranges, np.float32), np.ascontiguousarray(down)


def downward(shape: tuple[int, int], focal_length: float, pitch: float, roll: float) -> Map:
    """Vertical drop of each pixel's line of sight per metre of range, (H, W); see `directions`."""
    return (-directions(shape, focal_length, pitch, roll)[..., 2]).astype(np.float32)


def _open(rng: np.random.Generator, ranges: Map) -> Map:
    """Turn the view above a wavy line into open water."""
    height, width = ranges.shape
    points = drawn(rng, "place.open_water") + np.array([
        drawn(rng, "place.open_water_wave") for _ in range(8)])
    line = cv2.resize(
        points.astype(np.float32)[np.newaxis], (width, 1), interpolation=cv2.INTER_CUBIC) * height
    return np.where(np.arange(height)[:, np.newaxis] < line, np.float32(np.inf), ranges)


def _add_board(rng: np.random.Generator, reflectance: Map, ranges: Map) -> None:
    """Put a board in front of the scene: bright, near, plain or with dark fields.

    Most pixels then have one of two ranges, and near ones are bright in daylight, as under lamps.
    """
    height, width = ranges.shape
    median = float(np.median(ranges[np.isfinite(ranges)]))
    lean = math.radians(drawn(rng, "place.board_lean"))
    half = width * drawn(rng, "place.board_half")
    x = np.arange(width, dtype=np.float32) - np.float32(width * drawn(rng, "place.board_place"))
    y = np.arange(height, dtype=np.float32)[:, np.newaxis]
    y = y - np.float32(height * drawn(rng, "place.board_place"))
    # Coordinates on the board, -1..1.
    u = (math.cos(lean) * x + math.sin(lean) * y) / half
    v = (math.cos(lean) * y - math.sin(lean) * x) / (half * drawn(rng, "place.board_shape"))
    tilt, turn = drawn(rng, "place.board_tilt"), drawn(rng, "place.board_tilt")
    near = median * drawn(rng, "place.board_range") * (1.0 + tilt * v + turn * u)
    inside = (np.abs(u) < 1.0) & (np.abs(v) < 1.0) & (near < ranges)
    fields = count(rng, "place.board_fields")
    dark = (np.floor((u + 1.0) * fields / 2) + np.floor((v + 1.0) * fields / 2)) % 2 == 1
    albedo = np.where(dark, drawn(rng, "place.board_dark"), 1.0) * drawn(
        rng, "place.board_albedo")
    reflectance[inside] = albedo[inside, np.newaxis]
    ranges[inside] = near[inside]


def _add_fish(rng: np.random.Generator, reflectance: Map, ranges: Map) -> None:
    """Put fish in front of the scene: ellipses, dark above and light below."""
    height, width = ranges.shape
    known = np.isfinite(ranges)
    median = float(np.median(ranges[known])) if known.any() else 1.0
    albedo = np.array([drawn(rng, f"{table}.metal") for table in (
        "red_over_green", "albedo", "blue_over_green")])
    colour = albedo * np.array([albedo[1], 1.0, albedo[1]])
    for _ in range(int(drawn(rng, "place.fish"))):
        near = drawn(rng, "place.fish_range")
        length = width * drawn(rng, "place.fish_length") / near
        mask = np.zeros((height, width), np.uint8)
        centre = (int(rng.integers(width)), int(rng.integers(height)))
        tall = length * drawn(rng, "place.fish_shape")
        axes = (max(int(length), 2), max(int(tall), 1))
        cv2.ellipse(mask, centre, axes, drawn(rng, "place.fish_lean"), 0, 360, 1, -1)
        inside = (mask > 0) & (ranges > near * median)
        row = np.nonzero(inside)[0]
        belly = np.clip((row - centre[1]) / axes[1] + 1.0, 0.0, 2.0)[:, np.newaxis]
        reflectance[inside] = np.minimum(colour * (0.5 + belly), 1.0)
        ranges[inside] = near * median


def _thicker(
    streams: Streams, names: tuple[str, ...], ranges: Map, down: Map, median: float
) -> Map | None:
    """Factor of each pixel's optical path by plume and layer, (H, W, 1); None without them."""
    if "plume" not in names and "layer" not in names:
        return None
    factor = np.ones(ranges.shape, np.float32)
    height, width = ranges.shape
    if "plume" in names:
        rng = streams("plume")
        angle = rng.uniform(0.0, 2.0 * math.pi)
        x = np.linspace(-1.0, 1.0, width, dtype=np.float32)
        y = np.linspace(-1.0, 1.0, height, dtype=np.float32)[:, np.newaxis]
        side = np.float32(math.cos(angle)) * x + np.float32(math.sin(angle)) * y
        edge = np.float32(drawn(rng, "place.plume_edge"))
        width_of_edge = np.float32(drawn(rng, "place.plume_width"))
        share = np.clip((side - edge) / width_of_edge + 0.5, 0.0, 1.0)
        factor += np.float32(drawn(rng, "place.plume")) * share
    if "layer" in names:
        rng = streams("layer")
        below = np.where(np.isfinite(ranges), ranges, np.float32(1e4)) * down
        top = np.float32(drawn(rng, "place.layer_top") * median)
        # Share of the line of sight below the layer's top.
        share = np.clip(1.0 - top / np.maximum(below, 1e-6), 0.0, 1.0)
        factor += np.float32(drawn(rng, "place.layer")) * share
    return factor[..., np.newaxis]


def _transmissions(
    rng: np.random.Generator, names: tuple[str, ...], water: Water, ranges: Map,
    thicker: Map | None,
) -> tuple[Map, Map, Array]:
    """Transmission of surfaces' light, 1 − veil / veil at infinity, (H, W, 3), and effective β."""
    known = np.isfinite(ranges)
    path = ranges[..., np.newaxis] if thicker is None else ranges[..., np.newaxis] * thicker
    veil_factor = None
    if "veil coefficient" in names:
        common = 1.0 + drawn(rng, "veil.coefficient")
        veil_factor = np.array([
            common + drawn(rng, "veil.coefficient_channel") for _ in range(3)])
    if water.tables is None:
        transmission = _exp(path * -water.attenuation.astype(np.float32))
        if veil_factor is None:
            unveiled = transmission
        else:
            unveiled = _exp(path * -(water.attenuation * veil_factor).astype(np.float32))
    else:
        transmission, unveiled = (_look_up(path[..., 0], table) for table in water.tables)
        if veil_factor is not None:
            unveiled = cv2.exp(cv2.log(np.maximum(unveiled, 1e-30)) * veil_factor.astype(
                np.float32))
            unveiled[~known] = 0.0
    attenuation = water.attenuation
    if thicker is not None or water.tables is not None:
        distances, seen = ranges[known], transmission[known]
        step = max(len(distances) // 2000, 1)
        attenuation = fit_attenuation(distances[::step], seen[::step])
    return transmission, unveiled, attenuation


def _exp(exponent: NDArray[Any]) -> Map:
    """e^x by OpenCV, with x of at least −80: for −inf its result is not always 0."""
    return np.asarray(cv2.exp(np.maximum(exponent, np.float32(-80.0))), np.float32)


def _look_up(ranges: Map, logarithm: Array) -> Map:
    """Look up a table over `PATHS` in equal steps of the root of range, (H, W, 3); 0 at inf."""
    known = np.isfinite(ranges)
    most = float(ranges[known].max())
    roots = np.linspace(0.0, math.sqrt(most), _LOOKUP)
    table = np.stack(
        [np.exp(np.interp(roots**2, PATHS, logarithm[:, c])) for c in range(3)], 1)
    table = np.concatenate([table, np.zeros((1, 3))]).astype(np.float32)
    place = np.full(ranges.shape, _LOOKUP, np.int32)
    place[known] = np.rint(np.sqrt(ranges[known]) * ((_LOOKUP - 1) / math.sqrt(most)))
    return np.asarray(table[place])


def _light_map(
    streams: Streams, names: tuple[str, ...], water: Water, ranges: Map, down: Map, rows: Map,
    columns: Map,
) -> Map | None:
    """Light on the scene relative to W at the camera's depth, (H, W, 3) or (H, W, 1)."""
    found: Map | None = None
    known = np.isfinite(ranges)
    near = np.where(known, ranges, np.float32(0.0))
    if "light gradient" in names:
        below = near * down
        # Light does not increase above the water's surface.
        below = np.maximum(below, np.float32(-water.depth))[..., np.newaxis]
        found = np.asarray(cv2.exp(below * -water.diffuse.astype(np.float32)))
        found *= 1.0 + np.float32(
            drawn(streams("light gradient"), "light.gradient_across")) * columns
    if "caustics" in names:
        net = _caustics(streams("caustics"), near, down, columns)[..., np.newaxis]
        found = net if found is None else found * net
    if "shade" in names:
        rng = streams("shade")
        angle, edge = rng.uniform(0.0, 2.0 * math.pi), drawn(rng, "light.shade_edge")
        side = np.float32(math.cos(angle)) * columns + np.float32(math.sin(angle)) * rows
        share = np.clip(
            (side - np.float32(edge)) / np.float32(drawn(rng, "light.shade_width")), 0.0, 1.0)
        dim = (1.0 - np.float32(1.0 - drawn(rng, "light.shade")) * share).astype(np.float32)
        found = dim if found is None else found * dim
    return found


def _caustics(rng: np.random.Generator, ranges: Map, down: Map, columns: Map) -> Map:
    """Net of bright lines on the surfaces, of mean near 1, (H, W)."""
    tile = 256
    cells = 32
    noise = rng.standard_normal((cells, cells)).astype(np.float32)
    noise = np.pad(noise, 2, mode="wrap")
    size = tile + 4 * tile // cells
    noise = cv2.resize(noise, (size, size), interpolation=cv2.INTER_CUBIC)
    edge = 2 * tile // cells
    net = np.exp(-3.0 * np.abs(noise[edge:-edge, edge:-edge]))
    net /= net.mean()
    scale = np.float32(tile / cells / drawn(rng, "light.caustics_cell"))
    level = np.sqrt(np.maximum(1.0 - down * down, 1e-4))
    across = np.float32(_ACROSS) * columns[..., 0]
    mesh = cv2.remap(
        np.pad(net, ((0, 1), (0, 1)), mode="wrap"),
        np.mod(ranges * across * scale, tile).astype(np.float32),
        np.mod(ranges * level * scale, tile).astype(np.float32), cv2.INTER_LINEAR)
    return np.asarray(1.0 + np.float32(drawn(rng, "light.caustics")) * (mesh - 1.0), np.float32)


def scatter_forward(rng: np.random.Generator, direct: Map, transmission: Map) -> Map:
    """Blur surfaces' light in proportion to its optical path."""
    height = direct.shape[0]
    sigma = drawn(rng, "place.blur") * height / SIZE[0]
    optical = -cv2.log(np.maximum(transmission[..., 1], 1e-6))
    most = min(float(np.quantile(optical[::4, ::4], 0.95)), 4.0)
    if sigma * most < 0.3:
        return direct
    half = cv2.GaussianBlur(direct, (0, 0), 0.5 * sigma * most)
    full = cv2.GaussianBlur(half, (0, 0), math.sqrt(0.75) * sigma * most)
    place = (optical * np.float32(2.0 / most))[..., np.newaxis]
    first, second = np.clip(place, 0.0, 1.0), np.clip(place - 1.0, 0.0, 1.0)
    return np.asarray(direct + first * (half - direct) + second * (full - half), np.float32)


def _add_halo(rng: np.random.Generator, direct: Map, ranges: Map, rate: Array) -> Map:
    """Spread light that is scattered by small angles over the surroundings; light is conserved.

    Sharp light falls with β + `rate`, and the sum of sharp and blurred light with β (Jaffe 1990,
    doi:10.1109/48.50695, with the blurred part e^(−βd) − e^(−cd)). So contrast falls faster than
    light. The true β is that of even surroundings, which gain as much light as they lose.
    """
    known = np.isfinite(ranges)
    near = np.where(known, ranges, np.float32(0.0))[..., np.newaxis]
    sharp = direct * _exp(near * -rate.astype(np.float32))
    height, width = ranges.shape
    share = drawn(rng, "place.halo_share")
    seen, spread = sharp, direct - sharp
    for name, part, step in zip(
            ("place.halo_near", "place.halo_far"), (share, 1.0 - share), _HALO_STEPS, strict=True):
        size = (width // step, height // step)
        small = cv2.resize(spread, size, interpolation=cv2.INTER_AREA)
        blurred = cv2.GaussianBlur(
            small, (0, 0), drawn(rng, name) * size[0], borderType=cv2.BORDER_REFLECT)
        seen = seen + np.float32(part) * cv2.resize(
            blurred, (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(seen)


def _add_snow(rng: np.random.Generator, irradiance: Map, light: Array) -> None:
    """Add bright specks of near particles."""
    height, width = irradiance.shape[:2]
    specks = int(drawn(rng, "place.snow") * height * width)
    layer = np.zeros((height, width), np.float32)
    strength = drawn(rng, "place.snow_light")
    layer[rng.integers(height, size=specks), rng.integers(width, size=specks)] = (
        strength * rng.random(specks))
    few = np.zeros_like(layer)
    large = max(specks // 20, 1)
    few[rng.integers(height, size=large), rng.integers(width, size=large)] = (
        strength * _SPREAD * rng.random(large))
    layer += cv2.GaussianBlur(few, (0, 0), 1.5 * height / SIZE[0])
    layer = cv2.GaussianBlur(layer, (3, 3), 0.6)
    irradiance += layer[..., np.newaxis] * light.astype(np.float32)


def _grey(
    irradiance: Map, attenuation: Array, veil: Array, light: Array, ranges: NDArray[np.float32]
) -> tuple[Map, Array, Array, Array]:
    """Mix the channels into one, as in a monochrome camera; the truth is that of the mixture."""
    step = max(len(ranges) // 2000, 1)
    some = ranges[::step].astype(np.float64)
    decay = np.exp(-np.outer(some, attenuation)) @ (light / light.sum())
    mixed = fit_attenuation(some, decay[:, np.newaxis])
    grey = irradiance.mean(axis=-1, keepdims=True)
    return (
        np.repeat(grey, 3, axis=-1), np.repeat(mixed, 3),
        np.full(3, veil.mean()), np.full(3, light.mean()))


def _balance(streams: Streams, names: tuple[str, ...], irradiance: Map) -> Array:
    """Draw the gains of white balance, (3,); green's is 1."""
    gains = np.ones(3)
    if "white balance" in names:
        rng = streams("white balance")
        gains[0] = drawn(rng, "camera.white_balance_red")
        gains[2] = drawn(rng, "camera.white_balance_blue")
    if "grey world" in names:
        rng = streams("grey world")
        means = irradiance[::4, ::4].mean(axis=(0, 1), dtype=np.float64) * gains
        most = drawn(rng, "camera.grey_world_most")
        ratio = np.clip(means[1] / np.maximum(means, 1e-9), 1.0 / most, most)
        gains = gains * ratio ** drawn(rng, "camera.grey_world")
    return gains


def _exposure(rng: np.random.Generator, names: tuple[str, ...]) -> float:
    """Draw the irradiance of the brightest pixels; 1 is full scale."""
    if "low light" in names:
        return drawn(rng, "camera.low_light")
    if "over-exposure" in names:
        return drawn(rng, "camera.over_exposure")
    return drawn(rng, "scene.exposure")
