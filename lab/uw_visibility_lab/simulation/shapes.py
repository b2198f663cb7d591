# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Shapes of reefs and worlds for ray casting: ellipsoids, capsules and boxes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit

# Columns of a shape's row: kind, centre (3), axes (3, 3), half lengths (3), radius of the bounding
# sphere, index of the material, and height of lumps relative to that radius.
SHAPE_COLUMNS = 19
ELLIPSOID, CAPSULE, BOX = 0, 1, 2
"""Kinds. Half lengths: half axes; radius twice and half length of the axis; half sides."""

NOWHERE = 1e9

Vector = Sequence[float] | NDArray[np.float64]


def shape_row(
    kind: int, centre: Vector, half: Vector, axes: NDArray[np.float64] | None = None,
    material: int = 0, bump: float = 0.0,
) -> NDArray[np.float64]:
    """Return a shape's row for kernels, (SHAPE_COLUMNS,); its axes are the rows of `axes`."""
    bound = (
        max(half) if kind == ELLIPSOID else half[0] + half[2] if kind == CAPSULE
        else math.hypot(*half))
    own = np.eye(3) if axes is None else axes
    return np.array([kind, *centre, *own.ravel(), *half, bound, material, bump])


def axes_along(x: float, y: float, z: float) -> NDArray[np.float64]:
    """Axes (rows) whose third one points along a direction."""
    # By numbers: a reef has ten thousand of these, and NumPy's cross product takes far longer.
    length = math.sqrt(x * x + y * y + z * z)
    x, y, z = x / length, y / length, z / length
    # Across the first coordinate, or the second where that is nearly the direction itself.
    u, v, w = (0.0, -z, y) if abs(x) < 0.9 else (z, 0.0, -x)
    across = math.sqrt(u * u + v * v + w * w)
    u, v, w = u / across, v / across, w / across
    return np.array([
        [u, v, w], [y * w - z * v, z * u - x * w, x * v - y * u], [x, y, z]], np.float64)


def turned_axes(random: np.random.Generator, tilt: float) -> NDArray[np.float64]:
    """Draw axes (rows), turned about the vertical and tilted (standard deviation in rad)."""
    turn, tip = random.uniform(0.0, 2.0 * math.pi), tilt * random.standard_normal()
    c, s = math.cos(turn), math.sin(turn)
    ct, st = math.cos(tip), math.sin(tip)
    return np.array([[c, s, 0.0], [-s * ct, c * ct, st], [s * st, -c * st, ct]])


@njit(nogil=True, error_model="numpy")
def meet_shape(
    shape: Any, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float
) -> float:
    """Range at which a ray enters a shape, or `NOWHERE`."""
    px, py, pz = ox - shape[1], oy - shape[2], oz - shape[3]
    along = px * dx + py * dy + pz * dz
    if px * px + py * py + pz * pz - along * along > shape[16] * shape[16]:
        return NOWHERE
    # In the shape's own axes.
    ax = shape[4] * px + shape[5] * py + shape[6] * pz
    ay = shape[7] * px + shape[8] * py + shape[9] * pz
    az = shape[10] * px + shape[11] * py + shape[12] * pz
    bx = shape[4] * dx + shape[5] * dy + shape[6] * dz
    by = shape[7] * dx + shape[8] * dy + shape[9] * dz
    bz = shape[10] * dx + shape[11] * dy + shape[12] * dz
    kind = int(shape[0])
    hx, hy, hz = shape[13], shape[14], shape[15]
    if kind == 2:
        enter, leave = 0.0, NOWHERE
        for a, b, h in ((ax, bx, hx), (ay, by, hy), (az, bz, hz)):
            inverse = 1.0 / (b if abs(b) > 1e-9 else 1e-9)
            t0, t1 = (-h - a) * inverse, (h - a) * inverse
            enter, leave = max(enter, min(t0, t1)), min(leave, max(t0, t1))
        return enter if 0.0 < enter < leave else NOWHERE
    if kind == 0:
        ax, ay, az, bx, by, bz = ax / hx, ay / hy, az / hz, bx / hx, by / hy, bz / hz
        return _meet_quadratic(
            bx * bx + by * by + bz * bz, ax * bx + ay * by + az * bz,
            ax * ax + ay * ay + az * az - 1.0)
    # A capsule: the cylinder, then the spheres at both ends.
    found = _meet_quadratic(bx * bx + by * by, ax * bx + ay * by, ax * ax + ay * ay - hx * hx)
    if found < NOWHERE and abs(az + found * bz) > hz:
        found = NOWHERE
    for end in (-hz, hz):
        z = az - end
        t = _meet_quadratic(
            bx * bx + by * by + bz * bz, ax * bx + ay * by + z * bz,
            ax * ax + ay * ay + z * z - hx * hx)
        found = min(found, t)
    return found


@njit(nogil=True, error_model="numpy")
def _meet_quadratic(a: float, b: float, c: float) -> float:
    root = b * b - a * c
    if root < 0.0 or a < 1e-12:
        return NOWHERE
    t = (-b - math.sqrt(root)) / a
    return t if t > 0.0 else NOWHERE


@njit(nogil=True, error_model="numpy")
def shape_normal(
    shape: Any, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Outward unit normal of a shape at a point of its surface."""
    px, py, pz = x - shape[1], y - shape[2], z - shape[3]
    ax = shape[4] * px + shape[5] * py + shape[6] * pz
    ay = shape[7] * px + shape[8] * py + shape[9] * pz
    az = shape[10] * px + shape[11] * py + shape[12] * pz
    hx, hy, hz = shape[13], shape[14], shape[15]
    kind = int(shape[0])
    if kind == 0:
        ax, ay, az = ax / (hx * hx), ay / (hy * hy), az / (hz * hz)
    elif kind == 1:
        az = az - min(max(az, -hz), hz)
    else:
        ux, uy, uz = abs(ax) / hx, abs(ay) / hy, abs(az) / hz
        if ux >= uy and ux >= uz:
            ax, ay, az = math.copysign(1.0, ax), 0.0, 0.0
        elif uy >= uz:
            ax, ay, az = 0.0, math.copysign(1.0, ay), 0.0
        else:
            ax, ay, az = 0.0, 0.0, math.copysign(1.0, az)
    length = max(math.sqrt(ax * ax + ay * ay + az * az), 1e-12)
    return (
        (shape[4] * ax + shape[7] * ay + shape[10] * az) / length,
        (shape[5] * ax + shape[8] * ay + shape[11] * az) / length,
        (shape[6] * ax + shape[9] * ay + shape[12] * az) / length,
    )
