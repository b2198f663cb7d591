# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Drawings for a page: wide and narrow, in its colours, with names and values on hovering.

Colour-blind readers can distinguish the colours of data, which are from Okabe and Ito, Color
Universal Design (2008).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from io import StringIO
from typing import Any, NamedTuple

import matplotlib
from markupsafe import Markup, escape
from matplotlib.figure import Figure

from uw_visibility.errors import printable


class Shade(NamedTuple):
    """Colour on light and on dark pages, as ``#rrggbb``."""

    light: str
    dark: str


DATA = {
    "estimate": Shade("#0072b2", "#56b4e9"),
    "filtered": Shade("#d55e00", "#e69f00"),
    "sensor": Shade("#009e73", "#009e73"),
}
"""Colours of lines and points."""

SURFACES = {
    "paper": Shade("#ffffff", "#0d1117"),
    "raised": Shade("#f2f5f8", "#1b222b"),
    "ink": Shade("#1b1f24", "#e6edf3"),
    "muted": Shade("#4d5661", "#a9b4c0"),
    "rule": Shade("#c9d1d9", "#3d4650"),
    "link": Shade("#0a58a8", "#7cb8ff"),
    "warning": Shade("#fff5cc", "#3a2f0b"),
    "partial": Shade("#ffe3e0", "#471a1a"),
    "changed": Shade("#d8ecfd", "#12304d"),
}
"""Colours of the page."""

# Colours in figures, replaced by CSS variables of the page.
ESTIMATE, FILTERED, SENSOR = (DATA[name].light for name in ("estimate", "filtered", "sensor"))
INK, RULE, HOLLOW = SURFACES["ink"].light, SURFACES["rule"].light, SURFACES["muted"].light
_VARIABLES = {shade.light: name for name, shade in (DATA | SURFACES).items()}

# Widths in inches; the narrow drawing is for phones, with the same font size.
WIDE, NARROW = 9.0, 4.1
STYLE = {
    # Text stays text, for search, screen readers and the font of the page.
    "svg.fonttype": "none",
    "font.size": 9.0, "text.color": INK, "axes.labelcolor": INK, "axes.edgecolor": INK,
    "xtick.color": INK, "ytick.color": INK, "legend.labelcolor": INK,
    "figure.facecolor": "none", "axes.facecolor": "none", "savefig.facecolor": "none",
}


def variables(dark: bool) -> str:
    """Return the colours as CSS variables."""
    return " ".join(
        f"--{name}: {shade.dark if dark else shade.light};"
        for name, shade in (DATA | SURFACES).items()
    )


def themed(svg: str) -> str:
    """Return a drawing with the colour variables of the page."""
    drawn = "|".join(colour for colour in _VARIABLES if colour != SURFACES["paper"].light)
    return re.sub(
        rf"(fill|stroke): ({drawn})\b", lambda m: f"{m[1]}: var(--{_VARIABLES[m[2]]})", svg)


class Spot(NamedTuple):
    """Part of a drawing with a text that is shown when pointed at.

    It has the height of the axes, from `left` to `right` in their units.
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

    name: unique on the page; letters, digits, ``-``.
    title, description: title and content, for screen readers.
    height: inches.
    paint: draws into a figure, wide or narrow (True), and returns its spots.
    narrow_height: height of the narrow drawing; by default `height`.
    Returns two SVGs, of which the page shows one. Drawings are deterministic.
    """
    sizes = {"wide": (WIDE, height), "narrow": (NARROW, narrow_height or height)}
    return Markup("").join(
        _draw(f"{name}-{kind}", title, description, size, paint, kind)
        for kind, size in sizes.items())


def _draw(
    name: str, title: str, description: str, size: tuple[float, float], paint: Paint, kind: str
) -> Markup:
    narrow = kind == "narrow"
    # A fixed salt and no date make drawings deterministic.
    with matplotlib.rc_context(STYLE | {"svg.hashsalt": name}):
        figure = Figure(figsize=size)
        spots = list(paint(figure, narrow))
        stream = StringIO()
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
        # Touch screens do not hover.
        over = "" if narrow else _over(figure, spots)
    text = stream.getvalue()
    start = text.index(">", text.index("<svg")) + 1
    body = re.sub(r"<metadata>.*?</metadata>", "", text[start:], flags=re.DOTALL)
    # Ids must be unique on a page with several drawings.
    body = re.sub(r'\bid="', f'id="{name}-', body)
    body = re.sub(r'(href="#|url\(#)', rf"\g<1>{name}-", body).replace("xlink:href", "href")
    body = body.replace("</svg>", f"{over}</svg>")
    width, height = (72.0 * inches for inches in size)
    return Markup(
        f'<svg class="plot {kind}" role="img" viewBox="0 0 {width:g} {height:g}" '
        f'aria-labelledby="{name}-title {name}-desc"><title id="{name}-title">{escape(title)}'
        f'</title><desc id="{name}-desc">{escape(description)}</desc>{themed(body)}'
    )


def _over(figure: Figure, spots: Sequence[Spot]) -> str:
    """Return invisible areas over a drawing, with the texts of spots."""
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
