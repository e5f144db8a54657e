"""The code that an object runs through, as a hash: its module and every module of the house that it imports."""

from __future__ import annotations

import ast
import hashlib
import io
import sys
import tokenize
from functools import cache
from pathlib import Path

import mixo_env
from mixo_env.errors import PolicyError

HOUSE = "mixo_env"
ROOT = Path(mixo_env.__file__).parent


def code_hash(module: str) -> str:
    """Hash of a module and of all modules of this package that it imports, wherever in it.

    Comments, docstrings and empty lines do not enter, so words may be mended without a fit growing stale.

    Args:
        module: dotted name; one of a plug-in, too.

    Raises:
        PolicyError: when its source cannot be read.
    """
    waiting, found = [module], {}
    while waiting:
        name = waiting.pop()
        if name not in found:
            found[name], imported = _read(name)
            waiting += imported
    digest = hashlib.blake2b(digest_size=16)
    for name in sorted(found):
        digest.update(f"{name}:{found[name]};".encode())
    return digest.hexdigest()


@cache
def _read(module: str) -> tuple[str, tuple[str, ...]]:
    """Hash of the statements of one module, and the modules of the house that it imports."""
    path = _source(module)
    if path is None:
        raise PolicyError(f"{module}: expected its source beside it, found none: fit without a folder of weights")
    text = path.read_text(encoding="utf-8")
    tree = ast.parse(text)
    named: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            named |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            named |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    own = sorted(name for name in named if name.partition(".")[0] == HOUSE and _source(name) is not None)
    return hashlib.blake2b(statements(text, tree).encode(), digest_size=16).hexdigest(), tuple(own)


def statements(text: str, tree: ast.Module) -> str:
    """Source without comments, texts that stand alone, and empty lines: cut from the text, so equal in every Python."""
    lines = text.splitlines()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            row, column = token.start
            lines[row - 1] = lines[row - 1][:column]
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            for row in range(node.lineno - 1, node.end_lineno or node.lineno):
                lines[row] = ""
    return "\n".join(line.rstrip() for line in lines if line.strip())


@cache
def _source(module: str) -> Path | None:
    """The file of a module, which is not imported for that; ``None`` for a name that is none, or without source."""
    top, *rest = module.split(".")
    if top == HOUSE:
        stem = ROOT.joinpath(*rest)
        path = stem / "__init__.py" if stem.is_dir() else stem.with_suffix(".py")
    else:
        path = Path(getattr(sys.modules.get(module), "__file__", None) or "")
    return path if path.is_file() else None
