# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What is near the lens is told from the scene and from open water."""

import cv2
import numpy as np
import pytest
from scenes import blurred, codes, patches

from uw_visibility.water.foreground import foreground_mask

SHAPE = (240, 320)
WATER = np.array([0.2, 0.6, 0.8])


def view(thing=None, transfer="linear", dtype=np.uint8, seed=0):
    """A textured floor below open water, and perhaps a thing before it; with its points."""
    rng = np.random.default_rng(seed)
    light = np.empty((*SHAPE, 3))
    light[:] = WATER
    floor = patches(rng.uniform(0.1, 0.7, (32, 64)), 5)
    fade = np.linspace(0.2, 0.9, 160)[:, None, None]
    light[80:] = WATER + (floor[..., None] * [0.9, 1.0, 0.9] - WATER) * fade
    u, v = np.meshgrid(np.arange(2, 320, 5), np.arange(82, 240, 5))
    keep = np.ones(u.shape, bool)
    if thing is not None:
        mask = np.zeros(SHAPE, np.float32)
        cv2.circle(mask, (200, 160), 45, 1.0, -1)
        mask = blurred(mask, 5.0)[..., None]
        light = light * (1 - mask) + mask * np.asarray(thing)
        keep = mask[v, u, 0] < 0.4
    points = np.stack((u[keep], v[keep], 5 + (v[keep] - 80) / 8), axis=1).astype(np.float32)
    return codes(light, dtype, transfer), points


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("transfer", ["linear", "srgb"])
@pytest.mark.parametrize("thing", [(0.0, 0.0, 0.0), (0.95, 0.8, 0.7), (0.02, 0.3, 0.3)])
def test_a_thing_is_found_with_its_outline(thing, transfer, dtype):
    image, points = view(thing, transfer, dtype)
    mask = foreground_mask(image, points, transfer)
    assert mask.shape == SHAPE
    y, x = np.indices(SHAPE)
    distance = np.hypot(x - 200, y - 160)
    assert mask[distance < 45 + 10].all()
    assert not mask[distance > 45 + 45].any()


@pytest.mark.parametrize("transfer", ["linear", "srgb"])
def test_open_water_is_no_thing(transfer):
    image, points = view(transfer=transfer)
    assert foreground_mask(image, points, transfer) is None


def test_open_water_brighter_than_all_that_is_near_is_no_thing():
    """As in clear water over a dark floor."""
    image, points = view()
    image[80:] //= 3
    assert foreground_mask(image, points, "linear") is None


def test_a_dark_rock_at_the_edge_of_what_is_matched_is_scene():
    image, points = view()
    image[84:100, 100:220] = 0
    assert foreground_mask(image, points, "linear") is None


def test_a_plain_thing_within_the_scene_s_light_is_no_matter():
    image, points = view((0.3, 0.5, 0.6))
    assert foreground_mask(image, points, "linear") is None


def test_what_is_matched_is_scene_however_dark():
    image, _ = view((0.0, 0.0, 0.0))
    _, points = view()
    assert foreground_mask(image, points, "linear") is None


def test_where_nothing_is_matched_nothing_is_known():
    image, points = view((0.0, 0.0, 0.0))
    assert foreground_mask(image, points[:0], "linear") is None
