"""The house's import rule: each floor imports only from the floors below it, and heavy packages only where used."""

from __future__ import annotations

import ast
import functools
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent

FLOORS = (
    "docs._pages",
    "experiments",
    "baselines",
    "mixo_env.cli",
    "mixo_env.leaderboard",
    "mixo_env.scoring",
    "mixo_env.policies",
    "mixo_env.envs",
    "mixo_env.recordings",
    "mixo_env.experts",
    "mixo_env.simulator.dataset",
    "mixo_env.simulator.drive",
    "mixo_env.simulator.picture",
    "mixo_env.simulator.city",
    "mixo_env.simulator.config",
    "mixo_env.simulator",
    "mixo_env.metrics",
    "mixo_env.nuscenes",
    "mixo_env.trajectory",
    "mixo_env.tables",
    "mixo_env.fusion",
    "mixo_env.compiled",
    "mixo_env.caches",
    "mixo_env.geometry",
    "mixo_env.files",
    "mixo_env.errors",
)

MODULES = sorted(
    path.relative_to(ROOT)
    for package in ("mixo_env", "baselines", "experiments", "docs/_pages")
    for path in (ROOT / package).rglob("*.py")
)


def floor_of(module: str) -> int | None:
    """Index in FLOORS (0 = top), or None for modules outside the house."""
    for i, floor in enumerate(FLOORS):
        if module == floor or module.startswith(floor + "."):
            return i
    return None


def module_name(path: Path) -> str:
    parts = path.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@functools.cache
def imported_modules(path: Path) -> set[str]:
    found: set[str] = set()
    for node in ast.walk(ast.parse((ROOT / path).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module)
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


@pytest.mark.parametrize("path", MODULES, ids=str)
def test_imports_go_down_only(path: Path) -> None:
    own = floor_of(module_name(path))
    if own is None:
        assert module_name(path) == "mixo_env", "a module outside the floors: add its floor to FLOORS"
        return
    upward = {name for name in imported_modules(path) if (floor := floor_of(name)) is not None and floor < own}
    assert not upward, f"{path} imports from floors above its own: {sorted(upward)}"


def house_imports() -> dict[str, set[str]]:
    """Module -> modules of the house that it imports, wherever the import stands, also for type hints alone."""
    names = {module_name(path) for path in MODULES}
    return {module_name(path): (imported_modules(path) & names) - {module_name(path)} for path in MODULES}


def circle_through(graph: dict[str, set[str]]) -> list[str]:
    """The modules of one import circle in order, or nothing."""
    finished: set[str] = set()

    def search(module: str, way: list[str]) -> list[str]:
        if module in way:
            return way[way.index(module) :]
        if module in finished:
            return []
        for imported in sorted(graph.get(module, ())):
            if found := search(imported, [*way, module]):
                return found
        finished.add(module)
        return []

    return next((found for module in sorted(graph) if (found := search(module, []))), [])


def test_no_import_circle_among_files() -> None:
    circle = circle_through(house_imports())
    assert not circle, f"a circle of imports: {' -> '.join([*circle, *circle[:1]])}"


def test_a_circle_is_found() -> None:
    assert circle_through({"a": {"b"}, "b": {"c", "d"}, "c": {"a"}, "d": set()}) == ["a", "b", "c"]
    assert circle_through({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []


def test_importing_the_package_is_light() -> None:
    heavy = ("torch", "stable_baselines3", "matplotlib", "filterpy", "scipy", "pandas")
    code = f"import sys, mixo_env; print([name for name in {heavy!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
