# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Page of HTML that needs nothing from elsewhere, in light and dark."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from uw_visibility.errors import LONGEST_MESSAGE, printable
from uw_visibility.replay.report.svg import variables


def write_page(path: Path, template: str, **values: Any) -> None:
    """Write a page.

    Parameters
    ----------
    path : Path
        File to write.
    template : str
        Name of its template.
    values
        What the template needs; text is escaped, and freed of control characters.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("uw_visibility.replay.report"), autoescape=True,
        trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined, finalize=_shown,
    )
    text = environment.get_template(template).render(
        **values, colours_light=Markup(variables(dark=False)),
        colours_dark=Markup(variables(dark=True)),
    )
    path.write_text(text, encoding="utf-8")


def _shown(value: Any) -> Any:
    """Value as it is shown: text from outside without control characters."""
    own = isinstance(value, Markup) or not isinstance(value, str)
    return value if own else printable(value, LONGEST_MESSAGE)
