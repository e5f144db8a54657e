"""Fixtures that drive Chromium without a network; tests that use them are skipped where it, or its driver, is absent.

``tests/conftest.py`` gives them to every test; modules that use them carry the mark ``browser``. Chromium is the
program that ``MIXO_CHROMIUM`` names, else one found on the path.
"""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

DESKTOP = {"width": 1280, "height": 900}
PHONE = {"width": 390, "height": 844}
ARGUMENTS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)


def chromium() -> str | None:
    """Path of Chromium; ``None`` where there is none."""
    names = ("chromium", "chromium-browser", "google-chrome")
    return os.environ.get("MIXO_CHROMIUM") or next(filter(None, map(shutil.which, names)), None)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Chromium without a window."""
    driver = pytest.importorskip("playwright.sync_api", reason="takes the extra 'browser'")
    program = chromium()
    if program is None:
        pytest.skip("no Chromium: name it in MIXO_CHROMIUM or put it on the path")
    with driver.sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=program, headless=True, args=list(ARGUMENTS))
        yield started
        started.close()


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    """A page of desktop width without a network; asking for one, or an error of its scripts, fails the test."""
    context = browser.new_context(viewport=DESKTOP, offline=True)  # type: ignore[arg-type]
    opened = context.new_page()
    wrong: list[str] = []
    opened.on("pageerror", lambda error: wrong.append(str(error)))
    opened.on("console", lambda said: wrong.append(said.text) if said.type == "error" else None)
    opened.on("request", lambda asked: wrong.append(asked.url) if asked.url.startswith(("http", "ws")) else None)
    yield opened
    context.close()
    assert not wrong


def open_file(page: Page, path: Path) -> None:
    """Open a file and wait until its scripts have run."""
    page.goto(path.resolve().as_uri(), wait_until="load")


def wait_until(page: Page, expression: str, timeout_s: float = 30.0) -> None:
    """Ask again and again until an expression holds.

    Playwright's own waiting evaluates text inside the page, which pages with a content security policy forbid as soon
    as the answer is not there at once.
    """
    stop = time.monotonic() + timeout_s
    while not page.evaluate(expression):
        assert time.monotonic() < stop, f"not within {timeout_s:g} s: {expression}"
        page.wait_for_timeout(20)
