"""The house's sizes: short files, short functions, few parameters, typed kernels, no room that swallows the house."""

from __future__ import annotations

import ast
import functools
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parent.parent
FOLDERS = ("mixo_env", "baselines", "experiments", "docs", "examples", "tests")

FILE_LINES = 400
FUNCTION_LINES = 60
PERCENTILE_95_LINES = 34
"""Of code: a docstring may be as long as what it explains."""
PARAMETERS = 7
SHARE_OVER_PARAMETERS = 0.02
ROOM_SHARE = 0.25

Function = ast.FunctionDef | ast.AsyncFunctionDef

FILES = {path: path.read_text(encoding="utf-8") for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py"))}


@functools.cache
def all_functions() -> tuple[tuple[str, Function], ...]:
    """Parsed when first asked for: every worker of a run collects this file, one of them needs the trees."""
    found = []
    for path, text in FILES.items():
        name = path.relative_to(ROOT).as_posix()
        found += [(f"{name}: {node.name}", node) for node in ast.walk(ast.parse(text)) if isinstance(node, Function)]
    return tuple(found)


def functions(folder: str = "") -> Iterator[tuple[str, Function]]:
    """Path and name of every function, with its tree."""
    return (found for found in all_functions() if found[0].startswith(folder))


def lines_of(function: Function, *, docstring: bool = True) -> int:
    """From ``def`` to the last line, without decorators."""
    lines = (function.end_lineno or 0) - function.lineno + 1
    if docstring or ast.get_docstring(function) is None:
        return lines
    return lines - ((function.body[0].end_lineno or 0) - function.body[0].lineno + 1)


def parameters_of(function: Function) -> list[ast.arg]:
    """All but ``self`` and ``cls``, ``*args`` and ``**kwargs``."""
    arguments = function.args
    named = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
    return named[1:] if named and named[0].arg in ("self", "cls") else named


def is_kernel(function: Function) -> bool:
    return any("compiled" in ast.unparse(decorator) for decorator in function.decorator_list)


def room_of(path: Path) -> str:
    """A sub-package of ``mixo_env``; of the simulator, whose rooms are as large, one of its own sub-packages."""
    parts = path.relative_to(ROOT).parts[1:-1]
    return "/".join(parts[: 2 if parts[:1] == ("simulator",) else 1])


def test_files_are_short() -> None:
    lengths = {path.relative_to(ROOT).as_posix(): len(text.splitlines()) for path, text in FILES.items()}
    assert not {path: length for path, length in lengths.items() if length > FILE_LINES}


def test_functions_are_short() -> None:
    lengths = {name: lines_of(function) for name, function in functions()}
    assert not {name: n for name, n in lengths.items() if n > FUNCTION_LINES}


def test_19_of_20_functions_are_much_shorter() -> None:
    lengths = [lines_of(function, docstring=False) for _, function in functions("mixo_env/")]
    assert np.percentile(lengths, 95) <= PERCENTILE_95_LINES


def test_few_functions_take_many_parameters() -> None:
    counts = {name: len(parameters_of(function)) for name, function in functions("mixo_env/")}
    many = {name: count for name, count in counts.items() if count > PARAMETERS}
    assert len(many) <= SHARE_OVER_PARAMETERS * len(counts), many


def test_parameters_of_kernels_are_typed() -> None:
    kernels = {name: function for name, function in functions("mixo_env/") if is_kernel(function)}
    assert len(kernels) > 50  # they are found
    untyped = {
        name: [parameter.arg for parameter in parameters_of(kernel) if parameter.annotation is None]
        for name, kernel in kernels.items()
    }
    assert not {name: parameters for name, parameters in untyped.items() if parameters}


def test_no_room_swallows_the_house() -> None:
    rooms: Counter[str] = Counter()
    for path, text in FILES.items():
        if path.is_relative_to(ROOT / "mixo_env"):
            rooms[room_of(path)] += len(text.splitlines())
    room, lines = rooms.most_common(1)[0]
    assert lines < ROOM_SHARE * rooms.total(), f"{room}: {lines} of {rooms.total()} lines"


def test_a_docstring_is_not_code() -> None:
    (function,) = ast.parse('def f():\n    """One.\n\n    Two.\n    """\n    return 1').body
    assert isinstance(function, Function)
    assert (lines_of(function), lines_of(function, docstring=False)) == (6, 2)


@pytest.mark.parametrize(
    ("code", "expected"),
    [("def f(self, a, *, b): ...", ["a", "b"]), ("def f(a, /, b, *c, **d): ...", ["a", "b"]), ("def f(): ...", [])],
)
def test_parameters_are_counted(code: str, expected: list[str]) -> None:
    (function,) = ast.parse(code).body
    assert isinstance(function, Function)
    assert [parameter.arg for parameter in parameters_of(function)] == expected
