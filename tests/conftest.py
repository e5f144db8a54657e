"""Every test of a part of the long ones is an integration test; any test may drive a browser; collecting is quick."""

from __future__ import annotations

import gc
from collections.abc import Generator
from typing import Any

import pytest

from tests.browser import browser, page  # noqa: F401

PARTS = ("rendering", "site", "faults", "browser")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, Any, Any]:
    """Looking for garbage among the syntax trees of all tests, where there is none, took a fifth of the time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if any(item.get_closest_marker(part) for part in PARTS):
            item.add_marker("integration")
