# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Style of the figures of an evaluation: colours, lines, format."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib import colormaps, rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from uw_visibility_lab.evaluation.cases import IMAGES, MATCHES, READINGS

DPI = 130

DISPARITY_COLOURS = colormaps["turbo"].with_extremes(bad="black")
CHANNEL_COLOURS = {"red": "#cc2020", "green": "#1e8a34", "blue": "#2050cc"}

# Okabe and Ito's colours, which colour-blind people can distinguish: one for each
# method, the same in all figures.
OURS, OURS_BEFORE, PLAIN = "#0072b2", "#56b4e9", "#d55e00"
INPUT, HISTOGRAM, CLAHE, ORACLE = "#777777", "#cc79a7", "#e69f00", "#000000"

Style = dict[str, Any]


def _styles(
    titles: dict[str, str], *lines: tuple[str, str, str] | tuple[str, str, str, str]
) -> dict[str, Style]:
    """Return the styles of methods with `titles`, from name, colour, marker and line style."""
    return {
        name: {
            "label": titles[name], "color": colour, "marker": marker,
            "linestyle": line[0] if line else "-", "markersize": 5.0, "linewidth": 1.6,
        }
        for name, colour, marker, *line in lines
    }


READING_STYLES = _styles(
    READINGS, ("step1", OURS_BEFORE, "s"), ("pipeline", OURS, "o"), ("exact", OURS, "x", ":"),
    ("paper_pipeline", PLAIN, "v"), ("paper_exact", PLAIN, "+", ":"),
)
MATCH_STYLES = _styles(
    MATCHES, ("sgbm", INPUT, "^"), ("clahe_sgbm", CLAHE, "v"), ("oracle_sgbm", ORACLE, "D", ":"),
    ("ours_raw", OURS_BEFORE, "s"), ("ours", OURS, "o"),
)
IMAGE_STYLES = _styles(
    IMAGES, ("degraded", INPUT, "^"), ("histogram", HISTOGRAM, "P"), ("clahe", CLAHE, "v"),
    ("step1", OURS_BEFORE, "s"), ("final", OURS, "o"), ("oracle", ORACLE, "D", ":"),
)

TRUTH_STYLE = {"label": "truth", "color": "black", "linewidth": 1.2, "linestyle": "--"}

# Files have no dates, so that equal results give equal files.
_UNDATED = {
    ".pdf": {"CreationDate": None, "Producer": None}, ".svg": {"Date": None}, ".png": {},
}


def save(figure: Figure, path: Path) -> None:
    """Write a figure in the format of the file's suffix: png, pdf or svg."""
    FigureCanvasAgg(figure)
    with rc_context({"svg.hashsalt": "uw_visibility"}):
        figure.savefig(path, dpi=DPI, metadata=_UNDATED[path.suffix])
