"""The browser that other tests drive."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.browser import open_file

if TYPE_CHECKING:
    from playwright.sync_api import Page

pytestmark = pytest.mark.browser


def test_a_page_runs_its_scripts(page: Page, tmp_path: Path) -> None:
    file = tmp_path / "page.html"
    file.write_text("<p id=p></p><script>p.textContent = 1 + 1</script>", encoding="utf-8")
    open_file(page, file)
    assert page.inner_text("#p") == "2"
