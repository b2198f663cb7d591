# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Pictures of the paper's figures: bins (3), disparities (5), over depth (7), by method (9).

Fig. 3 shows pixels over range, their envelopes, and the fitted curves.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from uw_visibility.optics.light_model import transmission, veil_of
from uw_visibility_lab.evaluation.cases import IMAGES, MATCHES, CaseResult, Pictures
from uw_visibility_lab.evaluation.experiments import Evaluation
from uw_visibility_lab.evaluation.figures import curves
from uw_visibility_lab.evaluation.figures.style import CHANNEL_COLOURS, DISPARITY_COLOURS, save
from uw_visibility_lab.evaluation.tables import CHANNELS, grouped

SHOWN = ("degraded", "histogram", "clahe", "final", "oracle")
WIDTH = 2.9
# Number of pixels drawn per channel; more would merge into a dark area.
POINTS = 4000
IN_AIR = "#b0b0b0"
ENVELOPE: dict[str, Any] = {
    "markersize": 4.5, "markeredgewidth": 0.7, "color": "white", "markeredgecolor": "black",
}
CURVES = "I∞ (upper), I∞(1 − exp(−βd)) (lower)"
# Percentiles of range between which the axis is drawn, without outliers.
RANGE_PERCENTILES = (0.2, 99.8)


def draw_pictures(path: Path, cases: Sequence[CaseResult]) -> None:
    """Draw the scenes under water, by each method, and in air, with their ΔE*ab.

    Pixels are shown without gamma encoding, as in the paper.
    """
    figure, rows = _grid(cases, len(SHOWN) + 1)
    for row, case, pictures in rows:
        for axes, name in zip(row, SHOWN, strict=False):
            image = pictures.images.get(name)
            found = "pair refused" if image is None else (
                f"ΔE*ab = {case.colour_difference[name]:.1f}")
            _show(axes, image, f"{IMAGES[name]}\n{found}")
        _show(row[-1], pictures.radiance, f"{case.scene} in air")
    truth = cases[0].truth
    figure.suptitle(
        f"Enhancement at α = {truth.mean_attenuation:.3g} 1/m, z = {truth.depth:g} m "
        "(as Fig. 9 of the paper)"
    )
    save(figure, path)


def draw_disparities(path: Path, cases: Sequence[CaseResult]) -> None:
    """Draw Fig. 5: raw image, disparities of the raw and the enhanced pair, enhanced image."""
    figure, rows = _grid(cases, 4)
    for row, case, pictures in rows:
        _show(row[0], pictures.images["degraded"], f"{case.scene} under water")
        found = pictures.disparities
        known = found["ours"][np.isfinite(found["ours"])] if found else np.empty(0)
        limits = np.percentile(known, [1.0, 99.0]) if known.size else (0.0, 1.0)
        for axes, name in zip(row[1:3], ("ours_raw", "ours"), strict=True):
            how = "pair refused" if name not in found else (
                f"{case.matched[name]:.0%} matched, {case.correct[name]:.0%} correct")
            _show(axes, found.get(name), f"{MATCHES[name]}\n{how}",
                  cmap=DISPARITY_COLOURS, vmin=limits[0], vmax=limits[1])
        _show(row[3], pictures.images.get("final"), IMAGES["final"])
    figure.suptitle("Disparities and enhancement (as Fig. 5 of the paper); black is not matched")
    save(figure, path)


def _show(axes: Any, image: Any, title: str, **how: Any) -> None:
    """Show an image, if there is one, under a title."""
    if image is not None:
        axes.imshow(image, **how)
    axes.set_title(title, fontsize=9)


def _grid(
    cases: Sequence[CaseResult], columns: int
) -> tuple[Figure, list[tuple[Any, CaseResult, Pictures]]]:
    """Make a figure with a row of axes for each case that has pictures."""
    shown = [(case, case.pictures) for case in cases if case.pictures is not None]
    shapes = [pictures.radiance.shape for _, pictures in shown]
    heights = [WIDTH * shape[0] / shape[1] + 0.3 for shape in shapes]
    figure = Figure(figsize=(WIDTH * columns, sum(heights) + 0.7), layout="constrained")
    grid = figure.subplots(
        len(shown), columns, squeeze=False, gridspec_kw={"height_ratios": heights})
    for axes in grid.flat:
        axes.set_axis_off()
    return figure, [(row, *each) for row, each in zip(grid, shown, strict=True)]


def draw_over_depth(path: Path, cases: Sequence[CaseResult]) -> None:
    """Draw the pictures of Fig. 7: under water and enhanced, over depth."""
    scenes = grouped(cases, lambda case: case.scene)
    columns = max(len(of_scene) for of_scene in scenes.values())
    figure = Figure(figsize=(2.5 * columns, 4.2 * len(scenes) + 0.6), layout="constrained")
    grid = figure.subplots(2 * len(scenes), columns, squeeze=False)
    for axes in grid.flat:
        axes.set_axis_off()
    for number, of_scene in enumerate(scenes.values()):
        for column, case in enumerate(of_scene):
            for line, name in enumerate(("degraded", "final")):
                axes = grid[2 * number + line, column]
                if name in case.thumbnails:
                    axes.imshow(case.thumbnails[name])
                where = f"{case.scene}, z = {case.truth.depth:g} m\n" if line == 0 else ""
                axes.set_title(
                    f"{where}{IMAGES[name]}\nΔE*ab = {case.colour_difference[name]:.1f}",
                    fontsize=8)
    figure.suptitle(
        f"Increasing depth at α = {cases[0].truth.mean_attenuation:.3g} 1/m "
        "(as the pictures of Fig. 7 of the paper)")
    save(figure, path)


def draw_bins(path: Path, case: CaseResult) -> None:
    """Draw pixels, envelopes and fitted curves of a case.

    The grey points are the scene's radiance in air, the coloured ones the irradiance
    under water, over the true range. The lower curve is eq. 6 with the estimated β and
    I∞, the upper line is the estimated I∞ (eq. 7). Envelopes are over the pipeline's
    ranges.
    """
    pictures = case.pictures
    assert pictures is not None
    truth, reading = case.truth, case.readings["pipeline"]
    figure = Figure(figsize=(13.0, 5.6), layout="constrained")
    parts = figure.add_gridspec(2, 4, width_ratios=(0.95, 1.0, 1.0, 1.0))
    for row, (image, title) in enumerate((
        (pictures.radiance, "in air"), (pictures.images["degraded"], "under water"),
    )):
        axes = figure.add_subplot(parts[row, 0])
        axes.imshow(image)
        axes.set_title(title, fontsize=10)
        axes.set_axis_off()
    low, high = np.nanpercentile(pictures.range, RANGE_PERCENTILES)
    panels: list[Any] = []
    for channel, name in enumerate(CHANNELS):
        axes = figure.add_subplot(
            parts[:, channel + 1], sharey=panels[0] if panels else None
        )
        panels.append(axes)
        _draw_points(axes, pictures, channel)
        if pictures.envelope is not None:
            envelope = pictures.envelope
            axes.plot(
                envelope.range, envelope.bright[channel], "^", label="bright envelope", **ENVELOPE)
            # The darkest pixels of a bin have their own mean range.
            axes.plot(
                envelope.dark_range[channel], envelope.dark[channel], "v", label="dark envelope",
                **ENVELOPE)
        distance = np.linspace(0.0, 1.1 * high, 200)
        for water, colour, style, label in (
            (reading, CHANNEL_COLOURS[name], "-", "estimate, in the channel's colour"),
            (truth, "black", "--", "truth"),
        ):
            # Irradiance of a black patch (eq. 6), and open water.
            beta, ambient = water.attenuation[channel], water.ambient_light[channel]
            axes.plot(
                distance, veil_of(ambient, transmission(beta, distance)), style, color=colour,
                linewidth=1.8, label=f"{label}: {CURVES}")
            axes.axhline(ambient, linestyle=style, color=colour, linewidth=1.8)
        axes.set_xlim(0.95 * low, 1.02 * high)
        axes.set_ylim(0.0, 1.02)
        axes.set_xlabel("range d [m]")
        beta, sigma = reading.attenuation[channel], reading.attenuation_stddev[channel]
        estimate = f"β = {beta:.3f} ± {sigma:.3f}" if np.isfinite(beta) else "β not assessed"
        axes.set_title(
            f"{name}: {estimate} 1/m\n(truth {truth.attenuation[channel]:.3f} 1/m)", fontsize=9)
        axes.grid(alpha=0.25)
    panels[0].set_ylabel("irradiance E, radiance ρ")
    figure.legend(
        *axes.get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False,
        fontsize=9)
    figure.suptitle(
        f"{case.scene}: α = {truth.mean_attenuation:.3g} 1/m, z = {truth.depth:g} m "
        "(as Fig. 3 of the paper)"
    )
    save(figure, path)


def _draw_points(axes: Any, pictures: Pictures, channel: int) -> None:
    known = np.flatnonzero(np.isfinite(pictures.range))
    chosen = np.random.default_rng(0).permutation(known)[:POINTS]
    distance = pictures.range.ravel()[chosen]
    for image, colour, label in (
        (pictures.radiance, IN_AIR, "ρ, pixels in air"),
        (pictures.images["degraded"], CHANNEL_COLOURS[CHANNELS[channel]],
         "E, pixels under water, in the channel's colour"),
    ):
        values = image[..., channel].ravel()[chosen] / 255
        axes.plot(
            distance, values, ".", color=colour, alpha=0.35, markersize=2.5, markeredgewidth=0.0,
        )
        # Opaque points for the legend.
        axes.plot([], [], ".", color=colour, label=label)


def write_figures(folder: Path, evaluation: Evaluation, file_format: str = "png") -> None:
    """Write ``fig3_<scene>``, 5, 6, 7, 9 and ``reliability`` as ``png``, ``pdf`` or ``svg``."""
    def file(name: str) -> Path:
        return folder / f"{name}.{file_format}"

    shown = [case for case in evaluation.cases if case.pictures is not None]
    for case in shown:
        draw_bins(file(f"fig3_{case.scene}"), case)
    curves.draw_over_attenuation(file("fig6"), evaluation)
    draw_disparities(file("fig5"), shown)
    curves.draw_over_depth(file("fig7"), evaluation)
    draw_over_depth(file("fig7_pictures"), [case for case in evaluation.cases if case.thumbnails])
    draw_pictures(file("fig9"), shown)
    curves.draw_reliability(file("reliability"), evaluation.reliability())
