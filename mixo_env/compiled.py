"""The one way to compile: numba, with machine code on disk that is never older than any source it was made of.

Numba bakes constants and functions of other files into a function's machine code, but looks only at the function's own
file to tell whether code on disk is still good. Here the folder of that code carries a hash over every file of this
package that the function's module imports, directly or not: what was edited is compiled anew, what was put back is
found again. Numba chooses the folder when a function is decorated, so its setting is changed for that moment only and
the functions of other packages stay where they were. A function has one decorator: numba does not tell the code of
different options apart.

No function closes over the content of a data file; one that did would need that file in the hash as well.
"""

from __future__ import annotations

import functools
import hashlib
import os
import re
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from mixo_env.caches import user_cache_folder

Function = TypeVar("Function", bound=Callable[..., Any])

_PACKAGE = Path(__file__).parent
_STARTED_NS = time.time_ns()
_TICK_NS = 50_000_000  # files are dated by the kernel's coarse clock, which runs up to some ticks of 10 ms behind
_UNUSED_S = 7 * 86400.0
_LOCK = threading.Lock()

# An import statement of this package, wherever it stands. Parsing whole files would cost more than all other imports.
_IMPORT = re.compile(r"^[ \t]*(from|import)\b((?:\\\n|[^(\n])*(?:\([^)]*\))?)", re.MULTILINE)
_NAME = re.compile(r"[\w.]+")


def compiled(function: Function) -> Function:
    """Compile a function; dividing by zero is an error as in Python."""
    return _compile(function)


def compiled_unchecked(function: Function) -> Function:
    """Compile a function; dividing by zero gives inf or nan and costs no test."""
    return _compile(function, error_model="numpy")


def inlined(function: Function) -> Function:
    """Compile a short loop into its callers, as :func:`compiled_unchecked`, without counting references to arrays.

    For a run of twenty pixels the counting costs as much as the arithmetic. Such a function may cut arrays into views,
    but must neither make nor return one, and what it writes must not overlap anything else that it is given.
    """
    return _compile(function, error_model="numpy", forceinline=True, _nrt=False, pipeline_class=_apart())


@functools.cache
def compiled_once(loop: Callable[..., Any]) -> Callable[..., Any]:
    """``compiled`` for a loop that is also run as plain Python: called where speed is needed, once per process.

    Importing numba and loading machine code costs half a second, more than scoring one pair of files; both speeds run
    the same source and give the same numbers.
    """
    return compiled(loop)


def _compile(function: Any, **options: Any) -> Any:
    import numba
    import numba.core.config

    config: Any = numba.core.config
    if config.DISABLE_JIT:
        return _interpreted(function)
    with _numba_cache_for(Path(function.__code__.co_filename)) as found:
        return numba.njit(cache=found, **options)(function)


def _interpreted(function: Any) -> Any:
    """The function as plain Python, for coverage and debuggers: rows of structured arrays have attributes."""

    @functools.wraps(function)
    def call(*arguments: Any, **named: Any) -> Any:
        named = {name: _with_attributes(argument) for name, argument in named.items()}
        return function(*map(_with_attributes, arguments), **named)

    return call


def _with_attributes(argument: Any) -> Any:
    """A view in which ``rows[i].field`` reads and writes the same memory; anything else as it is."""
    structured = isinstance(argument, np.ndarray) and argument.dtype.names is not None
    return argument.view(np.recarray) if structured else argument


@contextmanager
def _numba_cache_for(source: Path) -> Iterator[bool]:
    """Set where numba puts the machine code of a function decorated meanwhile; False: there is no such place."""
    import numba.core.config

    config: Any = numba.core.config
    with _LOCK:
        theirs = {name: getattr(config, name, "") for name in ("CACHE_DIR", "CACHE_LOCATOR_CLASSES")}
        folder = cache_folder(source, theirs["CACHE_DIR"])
        try:
            if folder is not None:
                config.CACHE_DIR, config.CACHE_LOCATOR_CLASSES = str(folder), ""
            yield folder is not None
        finally:
            for name, value in theirs.items():
                setattr(config, name, value)


@functools.cache
def _apart() -> type:
    from numba.core.compiler import Compiler

    class Apart(Compiler):
        """Numba's usual compiler, told that the arrays passed to a function never overlap.

        A loop that gathers from a texture and writes a span runs in SIMD only with this promise.
        """

        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            self.state.flags.noalias = True

    return Apart


@functools.cache
def cache_folder(source: Path, base: str) -> Path | None:
    """Where the machine code of the functions in a file is kept.

    Args:
        source: the file.
        base: the user's setting for numba, ``NUMBA_CACHE_DIR``; if empty, the project's own folder of caches.

    Returns:
        A folder that exists and can be written; ``None`` if there is none (numba would then write beside the source,
        keyed by that alone), if sources cannot be read, or if one was changed since this process started: what was
        imported may then be older than what is on disk.
    """
    try:
        files = import_closure(source)
        if any(path.stat().st_mtime_ns > _STARTED_NS - _TICK_NS for path in files):
            return None
        digest = hashlib.blake2b(np.__version__.encode(), digest_size=8)  # global arrays are made by numpy
        for path in files:
            digest.update(path.as_posix().encode() + _read(path).digest)
        name = ".".join(source.relative_to(_PACKAGE.parent).with_suffix("").parts)
        root = Path(base).absolute() if base else user_cache_folder() / "numba"
        return _prepared(root / f"{name}-{digest.hexdigest()}")
    except (OSError, ValueError):
        return None


def _prepared(folder: Path) -> Path:
    """The folder, made if need be, marked as used and found writable; with a new one old ones are thrown away.

    Raises:
        OSError: it cannot be written.
    """
    if not folder.is_dir():
        folder.mkdir(parents=True, exist_ok=True)
        _prune(folder.parent)
    os.utime(folder)
    tempfile.TemporaryFile(dir=folder).close()
    return folder


def _prune(root: Path) -> None:
    """Remove this package's folders that no process has started to use for a week.

    Age alone decides, because other checkouts and running processes may share the root. A process that runs longer and
    compiles again makes its folder anew, so nothing but time is lost.
    """
    for folder in root.glob(f"{_PACKAGE.name}.*-*"):
        try:
            if time.time() - folder.stat().st_mtime > _UNUSED_S:
                shutil.rmtree(folder)
        except OSError:  # another process was quicker
            continue


def import_closure(source: Path) -> tuple[Path, ...]:
    """A file and all files of this package that it imports, directly or not, in functions too; sorted.

    Raises:
        OSError: one cannot be read.
    """
    found: set[Path] = set()
    waiting = [source]
    while waiting:
        path = waiting.pop()
        if path not in found:
            found.add(path)
            waiting += _read(path).imports
    return tuple(sorted(found))


class _Source(NamedTuple):
    """Digest of a file's bytes, and the files of this package that it names itself."""

    digest: bytes
    imports: tuple[Path, ...]


@functools.cache
def _read(path: Path) -> _Source:
    content = path.read_bytes()
    imports: set[Path] = set()
    for keyword, rest in _IMPORT.findall(content.decode("utf-8")):
        first, *others = _NAME.findall(rest) or [""]
        names = (first, *(f"{first}.{name}" if keyword == "from" else name for name in others))
        for name in names:
            if name.split(".", 1)[0] == _PACKAGE.name:
                imports |= _files_of(name)
    return _Source(hashlib.blake2b(content, digest_size=16).digest(), tuple(imports))


@functools.cache
def _files_of(module: str) -> frozenset[Path]:
    """Files that importing a module runs: its own and those of the packages around it. Empty: no such module."""
    stem = _PACKAGE.parent.joinpath(*module.split("."))
    own = next((path for path in (stem / "__init__.py", stem.with_suffix(".py")) if path.is_file()), None)
    if own is None:
        return frozenset()
    around = (folder / "__init__.py" for folder in stem.parents if folder.is_relative_to(_PACKAGE))
    return frozenset((own, *(path for path in around if path.is_file())))
