# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Pages in a browser: readable at every width, in light, dark and print; `make browser`."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from browsing import opened_browser, serious_violations, show

from uw_visibility.cli import main

pytestmark = pytest.mark.browser

WIDTHS = (390, 768, 1280)
# What is printed of A4, px of CSS.
PRINTED = (695, 1017)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with opened_browser() as opened:
        yield opened


@pytest.fixture(scope="module")
def day_file(transect: Path, dive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("days") / "day"
    assert main(["replay", str(transect), str(dive), "-o", str(out), "--jobs", "1"]) == 0
    return out / "index.html"


@pytest.fixture(scope="module", params=["report", "day"])
def page_file(request: pytest.FixtureRequest) -> Path:
    if request.param == "report":
        return Path(request.getfixturevalue("replayed")) / "report.html"
    return Path(request.getfixturevalue("day_file"))


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
    wanted = page.eval_on_selector_all("a, summary, button, select, .scroll", "all => all.length")
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


def times_shown(page: Any) -> list[str]:
    """Labels of the axes of time that are to be seen."""
    texts = page.eval_on_selector_all(".series svg.plot text", "all => all.filter(one => "
                                      "one.getClientRects().length).map(one => one.textContent)")
    return [text for text in texts if re.fullmatch(r"\d\d:\d\d:\d\d(\.\d)?", text)]


def points_shown(page: Any) -> list[dict[str, float]]:
    """Boxes of the first series' points, px, as far as its axes show them."""
    found: list[dict[str, float]] = page.evaluate("""() => {
        const plot = [...document.querySelectorAll(".series svg.plot")].find(
            one => one.getClientRects().length);
        const axes = plot.querySelector("[id$=patch_2]").getBoundingClientRect();
        const middle = box => (box.left + box.right) / 2;
        return [...plot.querySelectorAll(".data use")].map(one => one.getBoundingClientRect())
            .filter(box => box.width < 20 && middle(box) > axes.left && middle(box) < axes.right)
            .map(({ left, width, height }) => ({ left, width, height }));
    }""")
    return found


@pytest.mark.parametrize("width", WIDTHS)
def test_a_part_of_the_time_is_shown_in_all_series_by_keys(
    browser: Any, page_file: Path, width: int
) -> None:
    page = show(browser, page_file, width)
    whole, all_points = times_shown(page), points_shown(page)
    page.get_by_role("button", name="Zoom in").focus()
    page.keyboard.press("Enter")
    shown = page.inner_text(".zoom output")
    clock = r"(\d\d:\d\d:\d\d(?:\.\d)?)"
    first, last = re.fullmatch(rf"Shown: \d{{4}}-\d\d-\d\d, {clock} to {clock} UTC", shown).groups()
    ticks = times_shown(page)
    assert ticks and ticks != whole
    assert all(first <= tick <= last for tick in ticks)
    points = points_shown(page)
    assert 1 < len(points) < len(all_points)
    # Farther apart, and as large and round as before.
    assert points[1]["left"] - points[0]["left"] > 1.3 * (
        all_points[1]["left"] - all_points[0]["left"])
    for box in points:
        assert box["width"] == pytest.approx(all_points[0]["width"], abs=0.3)
        assert box["width"] == pytest.approx(box["height"], abs=0.3)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.get_by_role("button", name="Earlier").press("Enter")
    assert page.inner_text(".zoom output") < shown
    page.get_by_role("button", name="All").press("Enter")
    assert times_shown(page) == whole
    assert [box["left"] for box in points_shown(page)] == pytest.approx(
        [box["left"] for box in all_points], abs=0.1)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing_serious_where_a_part_is_shown(
    browser: Any, page_file: Path, scheme: str
) -> None:
    page = show(browser, page_file, 390, scheme)
    page.get_by_role("button", name="Zoom in").click()
    assert serious_violations(page) == []


def test_a_mouse_over_a_figure_chooses_what_its_values_are_then_told_of(
    browser: Any, replayed: Path
) -> None:
    page = show(browser, replayed / "report.html", 1280)
    spots = page.locator(".series svg.plot.wide").first.locator(".over rect")
    frames, chosen = spots.count(), spots.nth(2)
    axes = page.locator(".series svg.plot.wide [id$=patch_2]").first
    axes.scroll_into_view_if_needed()
    text, before, area = chosen.text_content(), chosen.bounding_box(), axes.bounding_box()
    y = area["y"] + area["height"] / 2.0
    page.mouse.move(before["x"] - 3.0, y)
    page.mouse.down()
    page.mouse.move(area["x"] + 0.8 * area["width"], y)
    page.mouse.up()
    after = chosen.bounding_box()
    assert frames > 4
    assert after["width"] > 1.1 * before["width"]
    assert after["x"] == pytest.approx(area["x"], abs=12.0)
    pointed = page.evaluate(
        "([x, y]) => document.elementFromPoint(x, y).textContent",
        [after["x"] + after["width"] / 2.0, y])
    assert pointed == text
    assert "single frame" in text


@pytest.mark.parametrize("width", [390, 1280])
def test_of_several_recordings_one_is_shown(browser: Any, day_file: Path, width: int) -> None:
    page = show(browser, day_file, width)
    names = page.locator(".zoom option").all_text_contents()
    page.get_by_label("Recording that is shown").select_option("transect")
    shown = page.inner_text(".zoom output")
    # Of the other recording, which goes on for longer, there is what fell into that time.
    assert sorted(names) == ["Recording", "dive", "transect"]
    first, last = re.findall(r"\d\d:\d\d:[\d.]+", shown)
    assert first <= "22:13:20.0" and "22:13:23.0" > last >= "22:13:22.5"
    assert page.input_value(".zoom select") == "transect"
    # Its end is a tick, whose label would reach beyond the drawing.
    labels, beyond = page.eval_on_selector_all(".series .ticks text", """all => {
        const right = one => one.getBoundingClientRect().right;
        const shown = all.filter(one => one.getClientRects().length);
        return [shown.length, shown.filter(one => right(one) > right(one.ownerSVGElement)).length];
    }""")
    assert labels > 4
    assert beyond == 0
    page.get_by_role("button", name="All").click()
    assert page.inner_text(".zoom output").startswith("Whole recording shown")
    assert page.input_value(".zoom select") == "Recording"


def test_without_scripts_the_whole_is_shown_and_no_button(browser: Any, page_file: Path) -> None:
    page = show(browser, page_file, 1280, scripts=False)
    assert page.locator(".series svg.plot.wide").first.is_visible()
    assert page.locator(".series svg.plot.wide text", has_text="time (UTC)").first.is_visible()
    assert not page.locator("button").first.is_visible()


def test_the_part_that_is_shown_is_what_is_printed(browser: Any, page_file: Path) -> None:
    page = show(browser, page_file, PRINTED[0])
    page.emulate_media(media="print")
    assert not page.locator(".zoom").is_visible()
    page.emulate_media(media="screen")
    page.get_by_role("button", name="Zoom in").click()
    page.emulate_media(media="print")
    assert page.locator(".zoom output").is_visible()
    assert not page.locator(".zoom button").first.is_visible()


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
