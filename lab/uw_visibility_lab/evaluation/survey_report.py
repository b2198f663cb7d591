# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Report of a survey under lamps: summary, tables, figure."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.optics.transfer import from_linear
from uw_visibility_lab.evaluation import style
from uw_visibility_lab.evaluation import survey as surveys
from uw_visibility_lab.evaluation.judging import HEAD, line_of, row_of
from uw_visibility_lab.evaluation.readings import OK, judged, reasons_text
from uw_visibility_lab.evaluation.report import Summary
from uw_visibility_lab.evaluation.survey import PICTURES, SurveyResult
from uw_visibility_lab.evaluation.tables import CHANNELS, as_text, flat, number, told, write_report


def summarise_survey(survey: SurveyResult) -> Summary:
    """Return a survey's results, of single frames and of the filter over them (``pooled``).

    ``first_assessed``: number of frames until there is an estimate. ``attenuation_error``:
    relative, after the last frame. ``variation``, ``colour_difference``: by names of `PICTURES`.
    """
    truth, last = survey.truth, survey.pooled[-1]
    errors = np.array(last.attenuation) / np.array(truth.attenuation) - 1.0
    first = next((k + 1 for k, each in enumerate(survey.pooled) if each.status == OK), None)
    return {
        "frames": len(survey.pooled),
        "single": row_of([judged(truth, reading) for reading in survey.single]),
        "pooled": row_of([judged(truth, reading) for reading in survey.pooled]),
        "first_assessed": first,
        "last_status": last.status,
        "attenuation": dict(zip(CHANNELS, truth.attenuation, strict=True)),
        "attenuation_error": dict(zip(CHANNELS, errors.tolist(), strict=True)),
        "variation": {
            name: dict(zip(CHANNELS, survey.variation[name].tolist(), strict=True))
            for name in PICTURES
        },
        "colour_difference": {name: survey.difference[name] for name in PICTURES},
    }


def survey_text(survey: SurveyResult, summary: Summary) -> str:
    """Return the summary as tables for a terminal."""
    errors = ", ".join(
        f"{name} {100 * error:+.0f} %" for name, error in summary["attenuation_error"].items())
    return "\n".join([
        f"survey of {summary['frames']} frames at night\n",
        HEAD,
        line_of("single frames", summary["single"]),
        line_of("with earlier frames", summary["pooled"]),
        *reasons_text("refused", survey.pooled),
        f"  error of β at the end: {errors} ({summary['last_status']})",
        as_text(["same reflectance over frames, σ/median [%]", "R", "G", "B", "ΔE*ab"], [
            [title, *(number(100.0 * summary["variation"][name][c], 1) for c in CHANNELS),
             number(summary["colour_difference"][name], 1)]
            for name, title in PICTURES.items()]),
    ])


def write_survey(
    folder: Path, config: PipelineConfig, survey: SurveyResult, summary: Summary
) -> None:
    """Write ``survey.csv``, ``evaluation.json`` and ``survey.png``."""
    frames = [
        flat({"frame": k, "true": survey.truth, "single": single, "pooled": pooled})
        for k, (single, pooled) in enumerate(zip(survey.single, survey.pooled, strict=True))]
    settings = {
        "frames": len(frames), "lamps": surveys.LAMPS,
        "mean_attenuation": surveys.MEAN_ATTENUATION, "parameters": told(config)}
    write_report(
        folder, {"survey": frames}, {"settings": settings, "summary": summary, "survey": frames})
    draw_survey(folder / "survey.png", survey)


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
        colour = style.CHANNEL_COLOURS[name]
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
    axes.plot([], [], ".", color=style.INPUT, label="single frames")
    axes.plot([], [], "--", color=style.INPUT, label="truth")
    lower.legend(
        *axes.get_legend_handles_labels(), loc="outside lower center", ncols=5, frameon=False,
        fontsize=8)
    axes.grid(alpha=0.25)
    style.save(figure, path)
