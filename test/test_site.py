# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Pages of the built site in a browser, on a telephone and on a desk; `make browser`."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from browsing import opened_browser, serious_violations, show

pytestmark = pytest.mark.browser

SITE = Path(os.environ.get("SITE", "no site")).resolve()
# Themes keep templates among their files.
PAGES = sorted(
    str(path.relative_to(SITE)) for path in SITE.rglob("*.html")
    if SITE / "_static" not in path.parents)
# What is wider than its place, and cannot be scrolled by itself.
CUT_OFF = """() => [...document.querySelectorAll('.bd-article *')].filter(one => {
    const shown = getComputedStyle(one);
    if (shown.display === 'inline' || shown.overflowX !== 'visible' || one.closest('svg, math')
        || one.clientWidth === 0 || one.scrollWidth <= one.clientWidth + 1) return false;
    for (let q = one.parentElement; !q.matches('.bd-article'); q = q.parentElement)
        if (['auto', 'scroll'].includes(getComputedStyle(q).overflowX)) return false;
    return true;
}).map(one => one.tagName + ' ' + one.textContent.trim().slice(0, 40))"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with opened_browser() as opened:
        yield opened


@pytest.mark.skipif(not PAGES, reason="no site is built: make docs browser")
@pytest.mark.parametrize(("width", "scheme"), [(390, "light"), (1280, "dark")])
@pytest.mark.parametrize("name", PAGES)
def test_a_page_fits_and_axe_finds_nothing_serious(
    browser: Any, name: str, width: int, scheme: str
) -> None:
    page = show(browser, SITE / name, width, scheme)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.evaluate(CUT_OFF) == []
    assert serious_violations(page) == []
    page.context.close()
