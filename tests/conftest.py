"""Every test of a part of the long ones is an integration test."""

from __future__ import annotations

import pytest

PARTS = ("site", "faults")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if any(item.get_closest_marker(part) for part in PARTS):
            item.add_marker("integration")
