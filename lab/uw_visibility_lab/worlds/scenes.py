# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Scenes without water: reflectance and range of a view, recorded or synthetic."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.errors import InputError, refusing
from uw_visibility.images.arrays import Map
from uw_visibility.optics.transfer import to_linear
from uw_visibility_lab.evaluation import degrade
from uw_visibility_lab.evaluation.degrade import fill_from_background
from uw_visibility_lab.evaluation.parallel import run_all
from uw_visibility_lab.simulation.camera import Pose, StereoCamera
from uw_visibility_lab.simulation.noise import noise_lattice
from uw_visibility_lab.simulation.raycast import relief_height
from uw_visibility_lab.simulation.shapes import (
    BOX,
    CAPSULE,
    ELLIPSOID,
    SHAPE_COLUMNS,
    Vector,
    axes_along,
    shape_row,
    turned_axes,
)
from uw_visibility_lab.worlds.beliefs import count, draw, happens
from uw_visibility_lab.worlds.geometry import (
    CHECKED,
    MIXED,
    STRIPED,
    TEXTURE,
    cast,
    picture_levels,
)

SIZE = (240, 320)
"""Rows and columns of a scene."""

NATURAL = ("sand", "rock", "rock", "algae", "coral", "coral", "silt")
"""Kinds of natural materials; those named twice are twice as frequent."""
BRANCHED, MASSIVE = 0.0, 1.0
"""Forms of corals, values of ``shape.coral_form``; the third one is a plate."""

MADE = ("metal", "board", "board")


@dataclass(frozen=True)
class Scene:
    """Colours and ranges of one view without water."""

    name: str  # for tables
    kind: str  # ``procedural``, ``picture on a plane``, ``rgbd``
    # (H, W, 3) float32; linear, 0..1, RGB: albedo and the shading of its surface
    reflectance: Map
    range: Map  # (H, W) float32; m along the line of sight; inf in open water
    pitch: float = math.nan  # of the camera, rad below the horizon; NaN if unknown
    roll: float = 0.0  # of the camera, rad, right side down
    focal_length: float = math.nan  # in widths of the image; NaN if unknown


def middlebury(folder: Path) -> Scene:
    """Read a Middlebury scene: view1, taken as linear reflectance, and ranges of disp1.

    Pixels without disparity are filled by `fill_from_background`; see `degrade.load_scene`.
    """
    scene = degrade.load_scene(folder)
    return Scene(
        folder.resolve().name, "rgbd", scene.left.astype(np.float32) / np.float32(255.0),
        scene.rig.range_from_disparity(fill_from_background(scene.disparity_left)),
        pitch=0.0, focal_length=scene.rig.focal_length / scene.left.shape[1])


def procedural(
    rng: np.random.Generator, pictures: Sequence[Map] = (), size: tuple[int, int] = SIZE
) -> Scene:
    """Make a random scene: ground, rocks, corals, walls, pipes, or a picture on a plane.

    The unit of range is arbitrary: the height of the camera over the ground.

    pictures: textures of objects, see `read_pictures`. size: rows and columns.
    """
    if pictures and happens(rng, "procedural.picture_plane"):
        return _picture_plane(rng, pictures, size)
    for _ in range(_TRIES):
        scene = _Builder(rng, pictures, size).scene()
        seen = np.isfinite(scene.range)
        near = scene.range < _TOO_NEAR * np.median(scene.range[seen]) if seen.any() else seen
        # Views of an object close to the lens, or of hardly anything but water, are of no use.
        if seen.mean() > _LEAST_SEEN and near.mean() < _MOST_NEAR:
            return scene
    raise InputError("no drawn scene shows enough surfaces: check the beliefs under [procedural]")


# Number of attempts to draw a scene; least share of pixels with surfaces, largest share of pixels
# that are too near, and limit of "too near" as a part of the median range.
_TRIES = 50
_LEAST_SEEN, _MOST_NEAR, _TOO_NEAR = 0.2, 0.3, 0.1


def _picture_plane(
    rng: np.random.Generator, pictures: Sequence[Map], size: tuple[int, int]
) -> Scene:
    """Put a picture on a tilted plane with smooth relief, which fills the view."""
    height, width = size
    picture = pictures[int(rng.integers(len(pictures)))]
    if happens(rng, "shape.plane_whole"):
        colours = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
    else:
        colours = np.tile(picture, (math.ceil(height / TEXTURE), math.ceil(width / TEXTURE), 1))
        colours = colours[:height, :width]
    rows = np.linspace(-1.0, 1.0, height, dtype=np.float32)[:, np.newaxis]
    columns = np.linspace(-1.0, 1.0, width, dtype=np.float32)
    tilt, turn = draw(rng, "shape.plane_tilt"), draw(rng, "shape.plane_turn")
    waves = rng.standard_normal((count(rng, "shape.plane_waves"), count(rng, "shape.plane_waves")))
    relief = cv2.resize(waves.astype(np.float32), (width, height), interpolation=cv2.INTER_CUBIC)
    inverse = 1.0 + tilt * rows + turn * columns + draw(rng, "shape.plane_relief") * relief
    pitch = math.radians(draw(rng, "camera.pitch"))
    return Scene(
        "plane", "picture on a plane", np.ascontiguousarray(colours, np.float32),
        (1.0 / np.maximum(inverse, 0.08)).astype(np.float32), pitch=pitch)


class _Builder:
    """Draws the parts of one procedural scene, and renders it."""

    def __init__(
        self, rng: np.random.Generator, pictures: Sequence[Map], size: tuple[int, int]
    ) -> None:
        self.rng = rng
        self.size = size
        self.shapes: list[NDArray[np.float64]] = []
        self.materials: list[NDArray[np.float64]] = []
        few = min(len(pictures), 4)
        # Pictures give the pattern only: the exposure of a photograph is not the albedo.
        self.pictures = [
            self.lit(pictures[int(k)]) for k in rng.choice(len(pictures), few, replace=False)
        ] if few else []
        # The palette of the scene: few materials, which many objects share.
        self.palette = [self.material() for _ in range(count(rng, "shape.palette"))]

    def lit(self, picture: Map) -> Map:
        """Scale a picture to the mean albedo of a random material."""
        kinds = (*NATURAL, *MADE)
        albedo = draw(self.rng, f"albedo.{kinds[int(self.rng.integers(len(kinds)))]}")
        gain = albedo / max(float(picture.mean()), 1e-3)
        return np.minimum(picture * np.float32(gain), np.float32(_BRIGHTEST))

    def material(self, kinds: Sequence[str] = NATURAL) -> int:
        """Draw a material; returns its index."""
        rng = self.rng
        kind = kinds[int(rng.integers(len(kinds)))]
        first = self.colour(kind)
        other = kind if happens(rng, "shape.same_kind") else kinds[int(rng.integers(len(kinds)))]
        second = self.colour(other)
        pattern, cell = MIXED, draw(rng, "shape.pattern_cell")
        # From a smooth mixture to patches with sharp edges.
        sharp = draw(rng, "shape.pattern_sharpness")
        if kind == "board":
            pattern = (MIXED, CHECKED, STRIPED)[int(rng.integers(3))]
            sharp = 20.0
        elif happens(rng, "shape.striped"):
            pattern = STRIPED
        coarse, fine = draw(rng, "procedural.variation"), draw(rng, "procedural.grain")
        persistence = draw(rng, "procedural.persistence")
        picture, cover = -1, 0.0
        if self.pictures and happens(rng, "procedural.picture_material"):
            picture = int(rng.integers(len(self.pictures)))
            cover = draw(rng, "shape.picture_cover")
            coarse *= 0.3
            fine *= 0.3
        row = np.array([
            pattern, *first, *second, cell, sharp, coarse, fine, persistence, picture, cover])
        self.materials.append(row)
        return len(self.materials) - 1

    def colour(self, kind: str) -> NDArray[np.float64]:
        """Draw an albedo of a kind of material, RGB."""
        green = draw(self.rng, f"albedo.{kind}")
        ratios = (draw(self.rng, f"red_over_green.{kind}"), 1.0,
                  draw(self.rng, f"blue_over_green.{kind}"))
        return np.minimum(green * np.array(ratios), _BRIGHTEST)

    def pick(self) -> int:
        """Pick a material of the palette."""
        return self.palette[int(self.rng.integers(len(self.palette)))]

    def add(
        self, kind: int, centre: Vector, half: Vector, material: int,
        axes: NDArray[np.float64] | None = None, bump: float = 0.0,
    ) -> None:
        """Add a shape; see `shape_row`."""
        self.shapes.append(shape_row(kind, centre, half, axes, material, bump))

    def place(self) -> tuple[float, float, float]:
        """Draw a point of the ground that is probably in view."""
        rng = self.rng
        # Evenly over the image: on rays through random pixels, up to a limited range.
        direction = self.directions[
            int(rng.integers(self.size[0])), int(rng.integers(self.size[1]))]
        down = max(-float(direction[2]), 0.12)
        reach = min(1.0 / down, 8.0)
        x, y = float(direction[0]) * reach, float(direction[1]) * reach
        return x, y, self.height(x, y)

    def height(self, x: float, y: float) -> float:
        """Height of the ground at a point."""
        return float(relief_height(self.relief, self.extent, self.slope, x, y))

    def scene(self) -> Scene:
        """Draw the whole scene and render it."""
        rng = self.rng
        height, width = self.size
        survey = happens(rng, "procedural.survey")
        pitch = math.radians(draw(rng, f"procedural.pitch_{'survey' if survey else 'ahead'}"))
        roll = math.radians(draw(rng, "procedural.roll"))
        focal = draw(rng, "procedural.focal_length")
        self.directions = directions(self.size, focal * width, pitch, roll)
        self.ground()
        for name, add in (
            ("boulders", self.boulders), ("corals", self.corals), ("pipes", self.pipes),
            ("blocks", self.blocks), ("poles", self.poles), ("fish", self.fish),
            ("overhang", self.overhang),
        ):
            if happens(rng, f"procedural.{name}"):
                add()
        reflectance = np.zeros((height, width, 3), np.float32)
        ranges = np.zeros((height, width), np.float32)
        sun = np.array([draw(rng, "shape.sun_slant"), draw(rng, "shape.sun_slant"), 1.0])
        levels = np.stack([picture_levels(p) for p in self.pictures]) if self.pictures else (
            np.zeros((1, 1, 3), np.float32))
        shapes = np.array(self.shapes).reshape(-1, SHAPE_COLUMNS)
        ground = np.array([self.pick(), self.pick()])
        cast(
            self.directions, shapes, self.relief, self.hollow, self.extent, self.slope, self.steep,
            _FARTHEST, np.array(self.materials), ground, draw(rng, "shape.ground_cell"),
            _lattice(int(rng.integers(_LATTICES))), levels, sun / np.linalg.norm(sun),
            draw(rng, "procedural.ambient"), happens(rng, "procedural.sun"),
            1.0 / (focal * width), reflectance, ranges)
        # Blur by the lens and by the pixel's area.
        seen = np.isfinite(ranges).astype(np.float32)
        share = cv2.GaussianBlur(seen, (0, 0), _SHARPNESS)[..., np.newaxis]
        soft = cv2.GaussianBlur(reflectance, (0, 0), _SHARPNESS) / np.maximum(share, 1e-3)
        soft *= seen[..., np.newaxis]
        return Scene(
            "procedural", "procedural", np.minimum(soft, np.float32(1.0)), ranges, pitch, roll,
            focal)

    def ground(self) -> None:
        """Draw the ground: fractal relief on a slope, with a wall or a canyon."""
        rng = self.rng
        self.extent = 12.0
        relief = draw(rng, "procedural.relief") * _fractal(rng, draw(rng, "procedural.hurst"))
        self.slope = 0.0 if happens(rng, "procedural.flat") else draw(rng, "procedural.slope")
        axis = (np.arange(_RELIEF) + 0.5) / _RELIEF * self.extent
        # The grid begins at the camera's place and is periodic: the second half lies behind.
        axis = np.where(axis > self.extent / 2, axis - self.extent, axis)
        x, y = axis[np.newaxis, :], axis[:, np.newaxis]
        wavy = 2.0 * relief
        if happens(rng, "procedural.wall"):
            away, tall = draw(rng, "shape.wall_distance"), draw(rng, "shape.wall_height")
            turn = draw(rng, "shape.wall_turn")
            side = y * math.cos(turn) + x * math.sin(turn) + wavy
            relief = relief + tall * _step((side - away) / draw(rng, "shape.wall_width"))
        elif happens(rng, "procedural.canyon"):
            half, tall = draw(rng, "shape.canyon_half"), draw(rng, "shape.canyon_height")
            bend = half * np.sin(0.5 * y + draw(rng, "shape.canyon_phase"))
            side = np.abs(x - bend * np.clip(y / 3.0, 0.0, 1.0)) + wavy
            relief = relief + tall * _step((side - half) / draw(rng, "shape.canyon_width"))
        tint = np.ones_like(relief)
        if happens(rng, "procedural.rubble"):
            _add_rubble(rng, relief, tint, self.extent / _RELIEF)
        # The camera is at height 1 above the ground below it.
        relief = relief - relief[0, 0]
        self.relief = np.ascontiguousarray(relief)
        # Hollows are darker, on two scales.
        lost = draw(rng, "procedural.occlusion")
        for cells in (3.0, 12.0):
            lower = cv2.GaussianBlur(relief, (0, 0), cells, borderType=cv2.BORDER_REFLECT) - relief
            depth = np.clip(lower / max(2.0 * float(lower.std()), 1e-6), 0.0, 1.0)
            tint = tint * (1.0 - lost * depth)
        self.hollow = np.ascontiguousarray(tint)
        grade = np.abs(np.gradient(relief, self.extent / _RELIEF)).max() + abs(self.slope)
        # With these steps rays seldom miss a ridge.
        self.steep = float(1.0 / (1.0 + min(grade, 3.0)))

    def boulders(self) -> None:
        """Add partly buried rocks."""
        rng = self.rng
        large = draw(rng, "shape.boulder_radius")
        for _ in range(count(rng, "shape.boulders")):
            x, y, z = self.place()
            r = large * draw(rng, "shape.boulder_spread")
            half = r * np.array([draw(rng, "shape.boulder_axis") for _ in range(3)])
            if math.hypot(x, y, z - 1.0) > 1.6 * half.max():
                self.add(ELLIPSOID, (x, y, z + 0.3 * r), half, self.pick(), turned_axes(rng, 0.4),
                         bump=draw(rng, "shape.boulder_bump"))

    def corals(self) -> None:
        """Add branching, massive and plate corals, and sponges."""
        rng = self.rng
        for _ in range(count(rng, "shape.corals")):
            x, y, z = self.place()
            material, r = self.pick(), draw(rng, "shape.coral_radius")
            if math.hypot(x, y, z - 1.0) < 4.0 * r:
                continue
            form = draw(rng, "shape.coral_form")
            if form == BRANCHED:
                for _ in range(count(rng, "shape.coral_branches")):
                    axes = axes_along(
                        draw(rng, "shape.coral_lean"), draw(rng, "shape.coral_lean"), 1.0)
                    long = r * draw(rng, "shape.coral_length")
                    thin = r * draw(rng, "shape.coral_width")
                    centre = np.array([x, y, z]) + axes[2] * long
                    self.add(CAPSULE, centre, (thin, thin, long), material, axes)
            elif form == MASSIVE:
                self.add(ELLIPSOID, (x, y, z + 0.3 * r), (1.5 * r, 1.5 * r, r), material,
                         turned_axes(rng, 0.1), bump=0.25)
            else:
                self.add(BOX, (x, y, z + 1.5 * r), (1.8 * r, 0.08 * r, 1.5 * r), material,
                         turned_axes(rng, 0.3))

    def pipes(self) -> None:
        """Add pipes that lie on the ground."""
        rng = self.rng
        material = self.material(MADE)
        for _ in range(count(rng, "shape.pipes")):
            x, y, z = self.place()
            turn, r = rng.uniform(0.0, math.pi), draw(rng, "shape.pipe_radius")
            axes = axes_along(math.cos(turn), math.sin(turn), draw(rng, "shape.pipe_slope"))
            if z + 2.0 * r < 0.8:
                self.add(CAPSULE, (x, y, z + 0.7 * r), (r, r, 20.0), material, axes)

    def blocks(self) -> None:
        """Add blocks and boards."""
        rng = self.rng
        for _ in range(count(rng, "shape.blocks")):
            x, y, z = self.place()
            half = draw(rng, "shape.block_half") * np.array([
                draw(rng, "shape.block_side") for _ in range(3)])
            if happens(rng, "shape.board"):
                half[int(rng.integers(3))] = 0.01
            if math.hypot(x, y, z - 1.0) > 1.5 * math.hypot(*half):
                self.add(BOX, (x, y, z + 0.7 * half[2]), half, self.material(MADE),
                         turned_axes(rng, 0.3))

    def poles(self) -> None:
        """Add upright poles and ropes."""
        rng = self.rng
        material = self.material(MADE)
        for _ in range(count(rng, "shape.poles")):
            x, y, z = self.place()
            r = draw(rng, "shape.pole_radius")
            if math.hypot(x, y) > 0.4 + 2.0 * r:
                axes = axes_along(draw(rng, "shape.pole_lean"), draw(rng, "shape.pole_lean"), 1.0)
                tall = draw(rng, "shape.pole_half")
                self.add(CAPSULE, (x, y, z + 1.0), (r, r, tall), material, axes)

    def fish(self) -> None:
        """Add fish in the water."""
        rng = self.rng
        material = self.material(("metal", "coral", "board"))
        r = draw(rng, "shape.fish_radius")
        for _ in range(count(rng, "shape.fish")):
            direction = self.directions[
                int(rng.integers(self.size[0])), int(rng.integers(self.size[1]))]
            x, y, z = direction * draw(rng, "shape.fish_range") + np.array([0.0, 0.0, 1.0])
            if z > self.height(x, y) + r:
                self.add(ELLIPSOID, (x, y, z), (2.5 * r, 0.5 * r, r), material,
                         turned_axes(rng, 0.1))

    def overhang(self) -> None:
        """Add rocks above: an overhang, an arch or a cave's mouth."""
        rng = self.rng
        material = self.pick()
        for _ in range(count(rng, "shape.overhangs")):
            half = np.array([draw(rng, "shape.overhang_half") for _ in range(3)])
            half[2] *= 0.6
            x, y = draw(rng, "shape.overhang_across"), draw(rng, "shape.overhang_ahead")
            z = 1.0 + half[2] * draw(rng, "shape.overhang_up")
            inside = (x / half[0]) ** 2 + (y / half[1]) ** 2 + ((z - 1.0) / half[2]) ** 2
            if inside > 1.5:
                self.add(ELLIPSOID, (x, y, z), half, material, turned_axes(rng, 0.1), bump=0.15)


# Noise lattices take long to make: a few are enough.
_LATTICES = 16
_RELIEF = 512
# Largest range, in heights of the camera.
_FARTHEST = 40.0
# Largest albedo.
_BRIGHTEST = 0.95
# Standard deviation of a point's image, px: 0.29 by the pixel's area, and as much by a good lens.
_SHARPNESS = 0.45


_lattice = lru_cache(maxsize=_LATTICES)(noise_lattice)


def _step(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rise smoothly from 0 at 0 to 1 at 1."""
    part = np.clip(x, 0.0, 1.0)
    return np.asarray(part * part * (3.0 - 2.0 * part))


def _fractal(rng: np.random.Generator, hurst: float) -> NDArray[np.float64]:
    """Periodic fractal surface of standard deviation 1, spectrum f^−(2H + 2)."""
    side = _RELIEF
    frequency = np.hypot(np.fft.fftfreq(side)[:, np.newaxis], np.fft.rfftfreq(side)[np.newaxis])
    frequency[0, 0] = 1.0
    # The longest waves are a third of the grid: longer ones would make the scene a mere slope.
    amplitude = np.maximum(frequency, 3.0 / side) ** (-hurst - 1.0)
    amplitude[0, 0] = 0.0
    spectrum = np.fft.rfft2(rng.standard_normal((side, side))) * amplitude
    surface = np.fft.irfft2(spectrum, (side, side))
    return np.asarray(surface / surface.std())


def _add_rubble(
    rng: np.random.Generator, relief: NDArray[np.float64], tint: NDArray[np.float64], cell: float
) -> None:
    """Add stones of random brightness to a relief with cells of width `cell`, in place."""
    side = len(relief)
    largest = draw(rng, "shape.rubble_radius")
    spread = draw(rng, "shape.rubble_spread")
    for _ in range(count(rng, "shape.rubble")):
        # In front of the camera: the rest of the grid is hardly visible.
        column, row = rng.integers(-side // 4, side // 4), rng.integers(0, side // 2)
        radius = largest * rng.random() ** 2 + cell
        reach = math.ceil(radius / cell)
        offsets = np.arange(-reach, reach + 1)
        place = np.ix_((row + offsets) % side, (column + offsets) % side)
        squared = ((offsets[:, np.newaxis] ** 2 + offsets**2) * cell * cell)
        inside = squared < radius * radius
        base = relief[row % side, column % side]
        top = base + 0.7 * np.sqrt(np.maximum(radius * radius - squared, 0.0))
        bright = math.exp(spread * rng.standard_normal())
        higher = inside & (top > relief[place])
        relief[place] = np.where(higher, top, relief[place])
        tint[place] = np.where(higher, bright, tint[place])


def directions(
    shape: tuple[int, int], focal_length: float, pitch: float, roll: float
) -> NDArray[np.float64]:
    """Unit vectors (H, W, 3) along the lines of sight, x right, y ahead, z up.

    The focal length is in px; pitch is below the horizon, roll with the right side down, rad.
    """
    pose = Pose((0.0, 0.0, 0.0), heading=math.pi / 2, tilt=pitch, roll=roll)
    rays = StereoCamera(shape[1], shape[0], focal_length).rig.ray_directions(shape)
    return np.asarray(rays @ pose.rotation().T)


IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png")


def read_pictures(folder: Path) -> list[Map]:
    """Read a folder's colour photographs (sRGB) as textures, sorted by name.

    Each is the largest square in the middle, (TEXTURE, TEXTURE, 3), linear. Other files, and
    pictures smaller than that, are left out.
    """
    if not folder.is_dir():
        raise InputError(f"there is no folder {folder}: give one with colour pictures")
    pictures = []
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() not in IMAGE_SUFFIXES:
            continue
        image = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if image is None or min(image.shape[:2]) < TEXTURE:
            continue
        side = min(image.shape[:2])
        top, left = ((n - side) // 2 for n in image.shape[:2])
        # Pixels are averaged as linear light.
        light = to_linear(np.ascontiguousarray(image[top:top + side, left:left + side, ::-1]),
                          "srgb")
        pictures.append(cv2.resize(light, (TEXTURE, TEXTURE), interpolation=cv2.INTER_AREA))
    if not pictures:
        raise InputError(f"{folder} holds no picture of {TEXTURE} px or more: give JPEG or PNG")
    return pictures


def make_pool(
    count: int, seed: int, folder: Path, pictures: Path | None = None,
    size: tuple[int, int] = SIZE, jobs: int = 1,
) -> None:
    """Make a pool of procedural scenes; each depends on its number and the seed only.

    folder: of the files ``<number>.npz``; existing ones are kept.
    pictures: folder of colour photographs, see `read_pictures`.
    size: rows and columns. jobs: number of processes.
    """
    textures = read_pictures(pictures) if pictures is not None else []
    jobs = max(1, min(jobs, count))
    # One share for each process, since each share gets a copy of the pictures.
    shares = [range(first, count, jobs) for first in range(jobs)]
    with refusing(f"cannot write a pool to {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
        make = partial(_make_scenes, seed=seed, folder=folder, textures=textures, size=size)
        run_all(make, shares, jobs, lambda done, _: done)


def _make_scenes(
    numbers: range, seed: int, folder: Path, textures: Sequence[Map], size: tuple[int, int]
) -> None:
    for number in numbers:
        path = folder / f"{number:06d}.npz"
        if path.exists():
            continue
        rng = np.random.default_rng([seed, number])
        save_scene(replace(
            procedural(rng, textures, size), name=f"pool {seed}.{number}"), path)


def save_scene(scene: Scene, path: Path) -> None:
    """Write a scene as .npz: colours, and ranges relative to their median, as float16."""
    known = np.isfinite(scene.range)
    median = float(np.median(scene.range[known])) if known.any() else 1.0
    part = path.with_suffix(".part")
    with part.open("wb") as file:
        np.savez(
            file, name=scene.name, kind=scene.kind,
            reflectance=scene.reflectance.astype(np.float16),
            # Relative to the median, 0.1 mm to kilometres are in the range of float16.
            range=(scene.range / np.float32(median)).astype(np.float16),
            camera=np.array([scene.pitch, scene.roll, scene.focal_length]))
    part.replace(path)


def load_scene(path: Path) -> Scene:
    """Read a scene that `save_scene` wrote; its ranges are relative to their median."""
    with refusing(f"cannot read the scene {path}", OSError, KeyError, ValueError), \
            np.load(path, allow_pickle=False) as stored:
        pitch, roll, focal = (float(x) for x in stored["camera"])
        return Scene(
            str(stored["name"]), str(stored["kind"]), stored["reflectance"].astype(np.float32),
            stored["range"].astype(np.float32), pitch, roll, focal)


def pool(folder: Path) -> list[Path]:
    """Return the files of a pool's scenes, sorted by name."""
    found = sorted(Path(folder).glob("*.npz"))
    if not found:
        raise InputError(
            f"{folder} holds no scene: make some with python -m uw_visibility_lab.worlds pool")
    return found
