# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Pages in a headless browser, and what axe-core says of them."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

AXE = Path(os.environ.get(
    "AXE_CORE", Path(__file__).parents[1] / "node_modules/axe-core/axe.min.js"))
BROWSERS = ("chromium", "chromium-browser", "google-chrome")


@contextmanager
def opened_browser() -> Iterator[Any]:
    """Open a browser; skips where there is none."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    path = next(filter(None, map(shutil.which, BROWSERS)), None)
    with playwright.sync_playwright() as run:
        try:
            # A container's root has no sandbox.
            opened = run.chromium.launch(executable_path=path, args=["--no-sandbox"])
        except playwright.Error as error:
            pytest.skip(f"no Chromium, no Chrome: {str(error).splitlines()[0]}")
        yield opened
        opened.close()


def show(
    browser: Any, path: Path, width: int, scheme: str = "light", height: int = 900,
    scripts: bool = True,
) -> Any:
    """Open a page; it asks for nothing, and nothing fails in it."""
    context = browser.new_context(
        viewport={"width": width, "height": height}, color_scheme=scheme,
        java_script_enabled=scripts)
    page = context.new_page()
    problems: list[str] = []
    page.on("console", lambda told: problems.append(told.text) if told.type == "error" else None)
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.on("request", lambda request: None if request.url.startswith(("file:", "data:"))
            else problems.append(request.url))
    page.goto(path.as_uri())
    assert not problems, problems
    return page


def serious_violations(page: Any) -> list[tuple[str, str, str]]:
    """Return what axe-core finds that is more than minor; skips where it is not there."""
    if not AXE.is_file():
        pytest.skip("needs axe-core: make browser")
    page.evaluate(AXE.read_text(encoding="utf-8"))
    found = page.evaluate("axe.run()")
    assert len(found["passes"]) > 20
    return [
        (rule["impact"], rule["id"], rule["nodes"][0]["html"]) for rule in found["violations"]
        if rule["impact"] not in ("minor",)
    ]
