# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Colours of pages and figures in light and dark, told apart by who is colour-blind.

Those of data are from Okabe and Ito, Color Universal Design (2008).
"""

from __future__ import annotations

import re
from typing import NamedTuple


class Shade(NamedTuple):
    """Colour in light and in dark.

    Attributes
    ----------
    light, dark : str
        As ``#rrggbb``.
    """

    light: str
    dark: str


DATA = {
    "estimate": Shade("#0072b2", "#56b4e9"),
    "filtered": Shade("#d55e00", "#e69f00"),
    "sensor": Shade("#009e73", "#009e73"),
}
"""Colours that lines and points are told apart by."""

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

# What figures are drawn in, to be put in place of by the page's own.
ESTIMATE, FILTERED, SENSOR = (DATA[name].light for name in ("estimate", "filtered", "sensor"))
INK, RULE, HOLLOW = SURFACES["ink"].light, SURFACES["rule"].light, SURFACES["muted"].light
_VARIABLES = {shade.light: name for name, shade in (DATA | SURFACES).items()}


def variables(dark: bool) -> str:
    """Return the colours as CSS variables."""
    return " ".join(
        f"--{name}: {shade.dark if dark else shade.light};"
        for name, shade in (DATA | SURFACES).items()
    )


def themed(svg: str) -> str:
    """Return a drawing whose colours are those of the page that it is in."""
    drawn = "|".join(colour for colour in _VARIABLES if colour != SURFACES["paper"].light)
    return re.sub(
        rf"(fill|stroke): ({drawn})\b", lambda m: f"{m[1]}: var(--{_VARIABLES[m[2]]})", svg)
