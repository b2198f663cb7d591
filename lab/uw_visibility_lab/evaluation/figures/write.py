# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""All figures of an evaluation, named after those of the paper."""

from __future__ import annotations

from pathlib import Path

from uw_visibility_lab.evaluation.experiments import Evaluation
from uw_visibility_lab.evaluation.figures import curves
from uw_visibility_lab.evaluation.figures.pictures import draw_bins, draw_disparities, draw_pictures
from uw_visibility_lab.evaluation.figures.pictures import (
    draw_over_depth as draw_pictures_over_depth,
)


def write_figures(
    folder: Path, evaluation: Evaluation, file_format: str = "png"
) -> list[Path]:
    """Write ``fig3_<scene>``, 5, 6, 7, 9 and ``reliability``; return the files.

    file_format: ``png``, ``pdf`` or ``svg``. Figures without data are left out.
    """
    written: list[Path] = []

    def file(name: str) -> Path:
        written.append(folder / f"{name}.{file_format}")
        return written[-1]

    shown = [case for case in evaluation.cases if case.pictures is not None]
    for case in shown:
        draw_bins(file(f"fig3_{case.scene}"), case)
    if evaluation.cases:
        curves.draw_over_attenuation(file("fig6"), evaluation)
        draw_disparities(file("fig5"), shown)
        curves.draw_over_depth(file("fig7"), evaluation)
        deeper = [case for case in evaluation.cases if case.thumbnails]
        if deeper:
            draw_pictures_over_depth(file("fig7_pictures"), deeper)
        draw_pictures(file("fig9"), shown)
        curves.draw_reliability(file("reliability"), evaluation.reliability())
    return written
