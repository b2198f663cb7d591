# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Drawings for a page: wide and narrow, in its colours, with names and values to hover over."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from io import StringIO
from typing import Any, NamedTuple

import matplotlib
from markupsafe import Markup, escape
from matplotlib.figure import Figure

from uw_visibility.errors import printable
from uw_visibility.replay.report.palette import INK, themed

# Inches; the narrow drawing is for a telephone, with the same size of letters.
WIDE, NARROW = 9.0, 4.1
STYLE = {
    # Text stays text: it can be found, read out and has the page's font.
    "svg.fonttype": "none",
    "font.size": 9.0, "text.color": INK, "axes.labelcolor": INK, "axes.edgecolor": INK,
    "xtick.color": INK, "ytick.color": INK, "legend.labelcolor": INK,
    "figure.facecolor": "none", "axes.facecolor": "none", "savefig.facecolor": "none",
}


class Spot(NamedTuple):
    """Part of a drawing that shows a text when it is pointed at.

    Attributes
    ----------
    axes : Axes
    left, right : float
        In units of the axes; it is as high as they are.
    text : str
    """

    axes: Any
    left: float
    right: float
    text: str


Paint = Callable[[Figure, bool], Iterable[Spot]]


def draw(
    name: str, title: str, description: str, height: float, paint: Paint,
    narrow_height: float | None = None,
) -> Markup:
    """Draw a figure for wide and for narrow pages.

    Parameters
    ----------
    name : str
        What tells it from all others of the page; letters, digits, ``-``.
    title, description : str
        What it is, and what is to be seen, for who does not see it.
    height : float
        Inches.
    paint : callable
        Draws into a figure, told whether it is the narrow one, and returns what can be
        pointed at there.
    narrow_height : float, optional
        Height of the narrow drawing; the same.

    Returns
    -------
    Markup
        Two SVGs, of which the page shows one. The same result has the same drawing.
    """
    return Markup("").join(
        _draw(f"{name}-{'narrow' if narrow else 'wide'}", title, description,
              (NARROW, narrow_height or height) if narrow else (WIDE, height), paint, narrow)
        for narrow in (False, True)
    )


def _draw(
    name: str, title: str, description: str, size: tuple[float, float], paint: Paint, narrow: bool
) -> Markup:
    # A fixed salt and no date: the same result has the same page.
    with matplotlib.rc_context(STYLE | {"svg.hashsalt": name}):
        figure = Figure(figsize=size)
        spots = list(paint(figure, narrow))
        stream = StringIO()
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
        # Where one touches, nothing is pointed at.
        over = "" if narrow else _over(figure, spots)
    text = stream.getvalue()
    start = text.index(">", text.index("<svg")) + 1
    body = re.sub(r"<metadata>.*?</metadata>", "", text[start:], flags=re.DOTALL)
    # Several drawings on a page: a name belongs to one thing.
    body = re.sub(r'\bid="', f'id="{name}-', body)
    body = re.sub(r'(href="#|url\(#)', rf"\g<1>{name}-", body).replace("xlink:href", "href")
    body = body.replace("</svg>", f"{over}</svg>")
    width, height = (72.0 * inches for inches in size)
    kind = "narrow" if narrow else "wide"
    return Markup(
        f'<svg class="plot {kind}" role="img" viewBox="0 0 {width:g} {height:g}" '
        f'aria-labelledby="{name}-title {name}-desc"><title id="{name}-title">{escape(title)}'
        f'</title><desc id="{name}-desc">{escape(description)}</desc>{themed(body)}'
    )


def fit_layout(figure: Figure) -> None:
    """Let matplotlib find room for all labels, which takes as long as to draw a figure."""
    figure.set_layout_engine("constrained")


def _over(figure: Figure, spots: Sequence[Spot]) -> str:
    """Return invisible areas over a drawing, with their texts."""
    width, height = 72.0 * figure.get_figwidth(), 72.0 * figure.get_figheight()
    parts = []
    for spot in spots:
        box = spot.axes.get_position()
        left, right = (
            figure.transFigure.inverted().transform(
                spot.axes.transData.transform((x, spot.axes.get_ylim()[0])))[0]
            for x in (spot.left, spot.right)
        )
        left, right = max(float(left), box.x0), min(float(right), box.x1)
        if right > left:
            parts.append(
                f'<rect x="{left * width:.1f}" y="{(1.0 - box.y1) * height:.1f}" '
                f'width="{(right - left) * width:.1f}" height="{box.height * height:.1f}">'
                f"<title>{escape(printable(spot.text))}</title></rect>"
            )
    return f'<g class="over">{"".join(parts)}</g>' if parts else ""
