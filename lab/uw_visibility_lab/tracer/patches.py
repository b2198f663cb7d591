# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""How the light of a patch falls with range: attenuation c, β, and what is between them.

    python -m uw_visibility_lab.tracer.patches -o FILE.json

A patch of radiance 1 in front of a camera, in water that is dark otherwise: seen is what went
straight, e^(-cd), and what was scattered by so little that it arrives still. The attenuation of
that is the patch's β; of a point it is c, of an endless surface it is nearly absorption's.
"""

from __future__ import annotations

import argparse
import json
from itertools import product
from pathlib import Path

import numpy as np

from uw_visibility.config.files import write_whole
from uw_visibility.images.arrays import Array
from uw_visibility.replay.progress import say
from uw_visibility_lab.tracer import engine
from uw_visibility_lab.tracer.phase import (
    FOURNIER_FORAND,
    HENYEY_GREENSTEIN,
    PETZOLD,
    phase_of,
)
from uw_visibility_lab.tracer.render import integrator

WATERS = (
    (HENYEY_GREENSTEIN, 0.77), (HENYEY_GREENSTEIN, 0.85), (HENYEY_GREENSTEIN, 0.92),
    (FOURNIER_FORAND, 0.0), (PETZOLD, 0.0))
"""Phase functions and mean cosines of Henyey and Greenstein's."""

ALBEDOS = (0.3, 0.5, 0.7, 0.85)
"""Single-scattering albedos."""

DIAMETERS = (0.01, 0.03, 0.1, 0.3, 1.0, 40.0)
"""Of patches, attenuation lengths 1/c; the last is endless."""

DISTANCES = (0.5, 1.0, 2.0, 3.0)
"""Attenuation lengths: contrast falls to 0.61 .. 0.05."""

SIDE = 64
"""Pixels of the narrow view of the patch's centre, squared."""


def slope(distances: Array, transmissions: Array, stddevs: Array) -> tuple[float, float]:
    """Slope of -log transmission, weighted, and its standard deviation.

    distances: (N,), attenuation lengths.
    transmissions, stddevs: (N,).
    Returns `slope, stddev`, β/c; the scatter about the line counts where it is above the noise.
    """
    # 1 % of each beside the noise: otherwise the nearest alone would count.
    noise = np.hypot(stddevs / transmissions, 0.01)
    design = np.stack([np.ones_like(distances), -distances], -1) / noise[:, None]
    inverse = np.linalg.inv(design.T @ design)
    found = inverse @ (design.T @ (np.log(transmissions) / noise))
    rest = np.log(transmissions) / noise - design @ found
    scatter = max(1.0, float(rest @ rest) / max(len(distances) - 2, 1))
    return float(found[1]), float(np.sqrt(inverse[1, 1] * scatter))


class PatchScene:
    """Water with a phase function and a patch in it, as Mitsuba holds them."""

    def __init__(self, phase: str, asymmetry: float, threads: int = 2) -> None:
        mi = self.mi = engine.mitsuba(threads)
        self._water = {
            "type": "homogeneous", "sigma_t": 1.0,
            "phase": mi.load_dict(phase_of(phase, asymmetry))}

    def transmission(
        self, albedo: float, diameter: float, distance: float, samples: int, seed: int = 1,
    ) -> tuple[float, float]:
        """Radiance of a patch's centre over that without water, and its standard deviation.

        albedo: single-scattering albedo.
        diameter, distance: attenuation lengths.
        samples: paths for each of `SIDE`² pixels.
        seed: of the paths.
        """
        mi = self.mi
        transform = mi.ScalarTransform4f
        scene = mi.load_dict({
            "type": "scene",
            "water": {**self._water, "albedo": albedo},
            "patch": {
                "type": "disk",
                "to_world": transform().look_at(
                    origin=[distance, 0, 0], target=[0, 0, 0], up=[0, 0, 1]).scale(
                    [diameter / 2.0, diameter / 2.0, 1.0]),
                "emitter": {"type": "area", "radiance": 1.0}},
            "sensor": {
                "type": "perspective", "fov": 0.02, "near_clip": 1e-4, "far_clip": 1e3,
                "to_world": transform().look_at(
                    origin=[0, 0, 0], target=[distance, 0, 0], up=[0, 0, 1]),
                "medium": {"type": "ref", "id": "water"},
                "film": {"type": "hdrfilm", "width": SIDE, "height": SIDE,
                         "rfilter": {"type": "box"}, "component_format": "float32",
                         "pixel_format": "luminance"},
                "sampler": {"type": "independent"}}})
        image = np.array(mi.render(
            scene, integrator=integrator(mi, "volpath"), spp=samples, seed=seed), float)
        known = image[np.isfinite(image)]
        return float(known.mean()), float(known.std() / np.sqrt(known.size))


def main() -> None:
    """Run the study and write its figures."""
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--samples", type=int, default=64)
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    rows = []
    for phase, asymmetry in WATERS:
        scene = PatchScene(phase, asymmetry, arguments.threads)
        for albedo, diameter in product(ALBEDOS, DIAMETERS):
            seen = [scene.transmission(albedo, diameter, distance, arguments.samples, 1 + k)
                    for k, distance in enumerate(DISTANCES)]
            transmissions, noise = (np.array(a) for a in zip(*seen, strict=True))
            ratio, stddev = slope(np.array(DISTANCES), transmissions, noise)
            rows.append({
                "phase": phase, "asymmetry": asymmetry, "albedo": albedo, "diameter": diameter,
                "ratio": round(ratio, 4), "stddev": round(stddev, 4),
                "transmissions": [float(f"{t:.5g}") for t in transmissions]})
            say(f"{phase} {asymmetry:g}, albedo {albedo:g}, {diameter:g}/c: "
                f"β/c {ratio:.3f} ± {stddev:.3f}")
            write_whole(arguments.output, json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
