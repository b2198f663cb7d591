# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Pages in a browser: readable at every width, in light, dark and print, for everyone."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from browsing import opened_browser, serious_violations, show

from uw_visibility.cli import main

pytestmark = pytest.mark.node

WIDTHS = (390, 768, 1280)
# What is printed of A4, px of CSS.
PRINTED = (695, 1017)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with opened_browser() as opened:
        yield opened


@pytest.fixture(scope="module", params=["report", "day"])
def page_file(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    if request.param == "report":
        return Path(request.getfixturevalue("replayed")) / "report.html"
    bags = [str(request.getfixturevalue(name)) for name in ("transect", "dive")]
    out = tmp_path_factory.mktemp("days") / "day"
    assert main(["replay", *bags, "-o", str(out), "--jobs", "1"]) == 0
    return out / "index.html"


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", WIDTHS)
def test_axe_finds_nothing_serious(
    browser: Any, page_file: Path, width: int, scheme: str
) -> None:
    page = show(browser, page_file, width, scheme)
    assert serious_violations(page) == []


@pytest.mark.parametrize("width", WIDTHS)
def test_nothing_is_cut_off_and_letters_are_large_enough(
    browser: Any, page_file: Path, width: int
) -> None:
    page = show(browser, page_file, width)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    shown = page.eval_on_selector_all(
        "svg.plot", "all => all.map(one => one.getBoundingClientRect().width).filter(w => w > 0)")
    assert shown
    assert min(shown) > 0.85 * min(width, 1000)
    heights = page.eval_on_selector_all(
        "svg.plot text", "all => all.map(t => t.getBoundingClientRect().height).filter(h => h > 0)")
    assert min(heights) >= 9.0


def test_dark_is_dark_figures_too(browser: Any, page_file: Path) -> None:
    def colour(page: Any, selector: str, name: str) -> int:
        text = page.eval_on_selector(selector, f"one => getComputedStyle(one).{name}")
        return sum(int(part) for part in text[text.index("(") + 1:-1].split(",")[:3])

    light, dark = (show(browser, page_file, 1280, scheme) for scheme in ("light", "dark"))
    for page, behind, ink in ((light, 765, 200), (dark, 100, 500)):
        background = colour(page, "body", "backgroundColor")
        text = colour(page, "svg.plot.wide text", "fill")
        assert (background == 765 and text < ink) if behind == 765 else (
            background < behind and text > ink)


def test_all_is_reached_by_keys(browser: Any, page_file: Path) -> None:
    page = show(browser, page_file, 390)
    wanted = page.eval_on_selector_all("a, summary, .scroll", "all => all.length")
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.className") == "skip"
    assert page.evaluate("document.activeElement.getBoundingClientRect().left") >= 0.0
    reached = 1
    for _ in range(2 * wanted):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement === document.body"):
            break
        reached += 1
    hidden = page.eval_on_selector_all("details:not([open]) .scroll", "all => all.length")
    assert reached == wanted - hidden


def test_headings_are_in_order_and_pictures_have_names(browser: Any, page_file: Path) -> None:
    page = show(browser, page_file, 1280)
    levels = page.eval_on_selector_all("h1, h2, h3", "all => all.map(h => +h.tagName[1])")
    assert levels[0] == 1 and levels.count(1) == 1
    assert all(after <= before + 1 for before, after in itertools.pairwise(levels))
    assert page.eval_on_selector_all("th:not([scope])", "all => all.length") == 0
    assert page.eval_on_selector_all("figure", "all => all.length") >= 3
    assert page.eval_on_selector_all(
        "figure:not(:has(figcaption)), img:not([alt]), svg.plot:not([role=img])",
        "all => all.length") == 0


def test_the_first_printed_page_is_full_and_pictures_keep_their_captions(
    browser: Any, page_file: Path
) -> None:
    page = show(browser, page_file, PRINTED[0], height=PRINTED[1])
    page.emulate_media(media="print")
    # The first figure that does not fit on the page goes to the next one, with its heading.
    tops = page.eval_on_selector_all("figure", "all => all.map(one => { "
                                     "const box = one.getBoundingClientRect(); "
                                     "return [box.top, box.bottom]; })")
    first = next((top for top, bottom in tops if bottom > PRINTED[1]), PRINTED[1])
    assert first > 0.6 * PRINTED[1]
    assert max(bottom - top for top, bottom in tops) < 0.5 * PRINTED[1]
    assert set(page.eval_on_selector_all(
        "figure", "all => all.map(one => getComputedStyle(one).breakInside)")) == {"avoid"}
    assert page.eval_on_selector(".plot.wide", "one => one.getBoundingClientRect().width") > 600
