"""Every test of a part of the long ones is an integration test; any test may drive a browser."""

from __future__ import annotations

import pytest

from tests.browser import browser, page  # noqa: F401

PARTS = ("rendering", "site", "faults", "browser")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if any(item.get_closest_marker(part) for part in PARTS):
            item.add_marker("integration")
