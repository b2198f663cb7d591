# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Figures of the evaluation: the paper's, reliability of confidence, and the survey's."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from uw_visibility.optics.light_model import transmission
from uw_visibility.optics.transfer import from_linear
from uw_visibility_lab.evaluation.cases import IMAGES, MATCHES, CaseResult, Pictures
from uw_visibility_lab.evaluation.degrade import title_of
from uw_visibility_lab.evaluation.experiments import Evaluation
from uw_visibility_lab.evaluation.metrics import expected_error
from uw_visibility_lab.evaluation.style import (
    CHANNEL_COLOURS,
    DISPARITY_COLOURS,
    IMAGE_STYLES,
    INPUT,
    MATCH_STYLES,
    OURS,
    READING_STYLES,
    TRUTH_STYLE,
    Style,
    save,
)
from uw_visibility_lab.evaluation.survey import PICTURES, SurveyResult
from uw_visibility_lab.evaluation.tables import CHANNELS, grouped

ROW_HEIGHT = 2.7
# Okabe and Ito's colours.
COLOURS = ("#000000", "#0072b2", "#009e73", "#e69f00", "#d55e00", "#cc79a7")
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


def write_figures(folder: Path, evaluation: Evaluation, file_format: str = "png") -> None:
    """Write ``fig3_<scene>``, 5, 6, 7, 9 and ``reliability`` as ``png``, ``pdf`` or ``svg``."""
    def file(name: str) -> Path:
        return folder / f"{name}.{file_format}"

    shown = [case for case in evaluation.cases if case.pictures is not None]
    for case in shown:
        draw_bins(file(f"fig3_{case.scene}"), case)
    draw_over_attenuation(file("fig6"), evaluation)
    draw_disparities(file("fig5"), shown)
    draw_over_depth(file("fig7"), evaluation)
    thumbnails = [case for case in evaluation.cases if case.thumbnails]
    draw_pictures_over_depth(file("fig7_pictures"), thumbnails)
    draw_pictures(file("fig9"), shown)
    draw_reliability(file("reliability"), evaluation.reliability())


class Panel(NamedTuple):
    """A column of a figure: a line for each method, over attenuation or depth."""

    label: str
    cases: Sequence[CaseResult]
    styles: Mapping[str, Style]
    value: Callable[[CaseResult, str], float]
    top: float | None = None  # upper end of the axis, which begins at 0


def draw_over_attenuation(path: Path, evaluation: Evaluation) -> None:
    """Draw Fig. 6: α̂, unmatched and correct fraction over α, at one depth.

    The paper shows the unmatched fraction only, of a "conventional stereo matching
    framework" and of its own. Matches may be wrong, so the correct fraction is added,
    also for each noise of the sensor that was evaluated.
    """
    depth = evaluation.plan.shown[1]
    cases = [case for case in evaluation.quiet if case.truth.depth == depth]
    correct = [("correct fraction", cases)]
    correct += [
        (f"correct, {title_of(noise)}", [c for c in evaluation.cases if c.noise == noise])
        for noise in evaluation.plan.noises]
    _draw_panels(
        path, f"Decreasing visibility at z = {depth:g} m (as Fig. 6 of the paper)",
        "mean attenuation α [1/m]", lambda case: case.truth.mean_attenuation, cases, [
            Panel("unmatched fraction", cases, MATCH_STYLES, lambda c, name: 1.0 - c.matched[name]),
            *(Panel(label, some, MATCH_STYLES, lambda c, name: c.correct[name], 1.0)
              for label, some in correct),
        ])


def draw_over_depth(path: Path, evaluation: Evaluation) -> None:
    """Draw Fig. 7: α̂ and ΔE*ab to the scene in air over z, at one α."""
    alpha = evaluation.plan.shown[0]
    cases = [
        case for case in evaluation.quiet if np.isclose(case.truth.mean_attenuation, alpha)]
    _draw_panels(
        path, f"Increasing depth at α = {alpha:.3g} 1/m (as Fig. 7 of the paper)",
        "depth z [m]", lambda case: case.truth.depth, cases,
        [Panel("ΔE*ab", cases, IMAGE_STYLES, lambda c, name: c.colour_difference[name])])


def _draw_panels(
    path: Path, title: str, label: str, abscissa: Callable[[CaseResult], float],
    cases: Sequence[CaseResult], panels: Sequence[Panel],
) -> None:
    """Draw α̂ with the truth and ± 1 σ of the pipeline, and the panels; one row per scene."""
    scenes = list(dict.fromkeys(case.scene for case in cases))
    estimates = Panel(
        "estimate of α [1/m]", cases, READING_STYLES,
        lambda c, name: c.readings[name].mean_attenuation)
    figure = Figure(
        figsize=(4.4 * len(panels) + 5.0, ROW_HEIGHT * len(scenes) + 1.7), layout="constrained")
    grid = figure.subplots(
        len(scenes), 1 + len(panels), sharex=True, sharey="col", squeeze=False)
    figure.get_layout_engine().set(w_pad=0.12)  # type: ignore[union-attr]
    for row, scene in zip(grid, scenes, strict=True):
        for axes, panel in zip(row, (estimates, *panels), strict=True):
            shown = [case for case in panel.cases if case.scene == scene]
            x = [abscissa(case) for case in shown]
            if panel is estimates:
                axes.plot(x, [case.truth.mean_attenuation for case in shown], **TRUTH_STYLE)
                ours = [case.readings["pipeline"] for case in shown]
                value, sigma = (
                    np.array([getattr(reading, name) for reading in ours])
                    for name in ("mean_attenuation", "mean_attenuation_stddev"))
                axes.fill_between(
                    x, value - sigma, value + sigma, color=OURS, alpha=0.15, linewidth=0.0,
                    label="± 1 σ of ours")
            for name, style in panel.styles.items():
                axes.plot(x, [panel.value(case, name) for case in shown], **style)
            axes.set_ylabel(panel.label)
            axes.grid(alpha=0.25)
        row[0].set_ylabel(f"{scene}\n{estimates.label}")
    for axes, panel in zip(grid[0, 1:], panels, strict=True):
        axes.set_ylim(0.0, panel.top)
    for axes in grid[-1]:
        axes.set_xlabel(label)
    figure.suptitle(title)
    # Legends below the panels hide no data.
    for axes, place in ((grid[0, 0], "outside lower left"), (grid[0, 1], "outside lower right")):
        figure.legend(
            *axes.get_legend_handles_labels(), loc=place, ncols=2, frameon=False, fontsize=8)
    save(figure, path)


def draw_reliability(
    path: Path, by_noise: Mapping[str, Sequence[Mapping[str, float]]]
) -> None:
    """Draw the share of right disparities over confidence, and its histogram, by noise."""
    figure = Figure(figsize=(6.4, 6.0), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    above.plot((0, 1), (0, 1), **{**TRUTH_STYLE, "label": "calibrated"})
    for k, (noise, rows) in enumerate(by_noise.items()):
        x = [row["confidence"] for row in rows]
        label = f"{title_of(noise)}: mean error {expected_error(rows):.3f}"
        colour = COLOURS[k % len(COLOURS)]
        above.plot(x, [row["right"] for row in rows], color=colour, marker="o", label=label)
        below.plot(x, [row["part"] for row in rows], color=colour, marker="o")
    above.set_ylabel("right share of disparities")
    above.set_ylim(0.0, 1.0)
    above.legend(frameon=False)
    below.set_ylabel("part of the matches")
    below.set_ylim(bottom=0.0)
    below.set_xlabel("confidence")
    below.set_xlim(0.0, 1.0)
    for axes in (above, below):
        axes.grid(alpha=0.25)
    figure.suptitle("Reliability of confidence")
    save(figure, path)


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


def draw_pictures_over_depth(path: Path, cases: Sequence[CaseResult]) -> None:
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
                distance, ambient * (1.0 - transmission(beta, distance)), style, color=colour,
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


def draw_survey(path: Path, survey: SurveyResult) -> None:
    """Draw frames of a survey by each method, and attenuation over its frames."""
    columns, rows = len(PICTURES), len(survey.shown)
    figure = Figure(figsize=(2.6 * columns, 2.1 * rows + 3.0), layout="constrained")
    upper, lower = figure.subfigures(2, 1, height_ratios=(2.1 * rows + 0.6, 2.4))
    grid = upper.subplots(rows, columns, squeeze=False)
    for k, pictures in enumerate(survey.shown):
        for axes, (name, title) in zip(grid[k], PICTURES.items(), strict=True):
            axes.imshow(from_linear(np.clip(pictures[name], 0.0, 1.0), "srgb", np.uint8))
            axes.set_axis_off()
            if k == 0:
                variation = ", ".join(f"{100.0 * v:.0f}" for v in survey.variation[name])
                axes.set_title(
                    f"{title}\nσ/median {variation} %, ΔE*ab {survey.difference[name]:.1f}",
                    fontsize=9)
    axes = lower.subplots()
    frames = np.arange(len(survey.pooled))
    for c, name in enumerate(CHANNELS):
        value, sigma = (
            np.array([getattr(reading, field)[c] for reading in survey.pooled])
            for field in ("attenuation", "attenuation_stddev")
        )
        colour = CHANNEL_COLOURS[name]
        axes.fill_between(
            frames, value - sigma, value + sigma, color=colour, alpha=0.15, linewidth=0.0)
        axes.plot(frames, value, color=colour, label=f"{name}, with earlier frames")
        axes.axhline(survey.truth.attenuation[c], color=colour, linestyle="--")
        axes.plot(
            frames, [reading.attenuation[c] for reading in survey.single], ".", color=colour,
            alpha=0.4)
    axes.set_ylim(0.0, 2.0 * max(survey.truth.attenuation))
    axes.set_xlabel("frame")
    axes.set_ylabel("β [1/m], ± 1 σ")
    axes.plot([], [], ".", color=INPUT, label="single frames")
    axes.plot([], [], "--", color=INPUT, label="truth")
    lower.legend(
        *axes.get_legend_handles_labels(), loc="outside lower center", ncols=5, frameon=False,
        fontsize=8)
    axes.grid(alpha=0.25)
    save(figure, path)
