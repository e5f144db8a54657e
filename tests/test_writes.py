"""Files are written by mixo_env/files.py alone, so that an interrupted program never leaves half of one."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
FOLDERS = ("mixo_env", "experiments", "baselines", "docs/_pages")
WRITER = "mixo_env/files.py"

IN_A_TEMPORARY_FOLDER = {
    "experiments/fuzz/folders.py": "damages files of a throw-away folder, one after the other",
    "experiments/fuzz/networks.py": "damages trained networks in a throw-away folder",
    "experiments/fuzz/policies.py": "damages a saved policy in a throw-away folder",
    "experiments/fuzz/stores.py": "damages recordings in a throw-away folder",
    "experiments/fuzz/trajectories.py": "damages trajectory files in a throw-away folder",
    "experiments/peers/orbslam3_api.py": "answers into the temporary folder of orbslam3_client, without this package",
    "experiments/peers/orbslam3_client.py": "hands images to another process in a temporary folder",
    "experiments/speed/loading.py": "streams hundreds of megabytes of tables into a temporary folder",
    "mixo_env/leaderboard/film.py": "OpenCV tells the container by suffix; then the film is written at once",
}
"""Files that write directly, and why they may."""

FIRST_ARGUMENT = {"savefig", "imwrite", "imsave", "savez", "savez_compressed", "savetxt", "save_file", "VideoWriter"}
FIRST_ARGUMENT |= {"np.save", "numpy.save", "torch.save", "ParquetWriter", "tofile", "mimsave"}
OPENERS = {"open", "ZipFile", "fdopen"}
BUFFERS = {"BytesIO", "StringIO"}


def name_of(function: ast.expr) -> str:
    """``open``, ``savefig``, ``np.save``: the last name of what is called, ``save`` with what it belongs to."""
    if isinstance(function, ast.Attribute):
        owner = function.value.id if isinstance(function.value, ast.Name) else ""
        return f"{owner}.save" if function.attr == "save" else function.attr
    return function.id if isinstance(function, ast.Name) else ""


def target_of(call: ast.Call) -> ast.expr | None:
    """What a call writes to, or nothing if it writes no file."""
    name, is_method = name_of(call.func), isinstance(call.func, ast.Attribute)
    owner = call.func.value if isinstance(call.func, ast.Attribute) else None
    first = call.args[0] if call.args else None
    if name in ("write_text", "write_bytes"):
        return owner if is_method else None
    if name in FIRST_ARGUMENT:
        return first
    if name == "dump" and len(call.args) > 1:
        return call.args[1]
    if name.endswith(".save") and {word.arg for word in call.keywords} & {"format", "save_all"}:
        return first
    if name in OPENERS and not (isinstance(owner, ast.Name) and owner.id == "os" and name == "open"):
        modes = [*call.args[:2], *(word.value for word in call.keywords if word.arg == "mode")]
        texts = [node.value for node in modes if isinstance(node, ast.Constant) and isinstance(node.value, str)]
        if any(set(text) <= set("rwaxbt+") and set(text) & set("wax+") for text in texts):
            return owner if name == "open" and is_method else first
    return None


def harmless_names(function: ast.AST) -> set[str]:
    """Names of temporary files of ``atomic_path``, of what was opened there, of buffers and of standard output."""
    found: set[str] = {"sys"}
    for node in ast.walk(function):
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Call) and name_of(node.value.func) in BUFFERS:
            found |= {target.id for target in node.targets if isinstance(target, ast.Name)}
        for item in node.items if isinstance(node, ast.With) else ():
            if isinstance(item.optional_vars, ast.Name) and isinstance(item.context_expr, ast.Call):
                target = target_of(item.context_expr)
                if name_of(item.context_expr.func) == "atomic_path" or root_of(target) in found:
                    found.add(item.optional_vars.id)
    return found


def root_of(target: ast.expr | None) -> str:
    while isinstance(target, ast.Attribute):
        target = target.value
    return target.id if isinstance(target, ast.Name) else ""


def direct_writes(node: ast.AST) -> Iterator[int]:
    """Lines of calls that write to anything but a temporary file of ``atomic_path`` in the same function."""
    for inner in ast.iter_child_nodes(node):
        if isinstance(inner, ast.FunctionDef):
            names = harmless_names(inner)
            calls = [call for call in ast.walk(inner) if isinstance(call, ast.Call)]
            yield from (call.lineno for call in calls if (to := target_of(call)) and root_of(to) not in names)
        elif isinstance(inner, ast.Call) and target_of(inner):
            yield inner.lineno
        else:
            yield from direct_writes(inner)


def files() -> list[str]:
    paths = (path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))
    return sorted(path.relative_to(ROOT).as_posix() for path in paths)


def lines_in(path: str) -> list[int]:
    return list(direct_writes(ast.parse((ROOT / path).read_text(encoding="utf-8"))))


@pytest.mark.parametrize("path", sorted(set(files()) - {WRITER} - set(IN_A_TEMPORARY_FOLDER)))
def test_files_are_written_whole_or_not_at_all(path: str) -> None:
    assert not lines_in(path), f"{path} writes files itself in these lines: use mixo_env.files"


@pytest.mark.parametrize("path", sorted(IN_A_TEMPORARY_FOLDER))
def test_every_exception_is_still_one(path: str) -> None:
    assert lines_in(path), f"{path} writes nothing itself any more: strike it off the list"


@pytest.mark.parametrize(
    "line",
    [
        "path.write_text('x')",
        "(folder / 'a').write_bytes(b'')",
        "open(path, 'w')",
        "open(path, mode='ab')",
        "path.open('x')",
        "figure.savefig(path, dpi=1)",
        "cv2.imwrite(str(path), image)",
        "np.save(path, array)",
        "np.savez(path, a=array)",
        "json.dump(value, file)",
        "zipfile.ZipFile(path, 'w')",
        "image.save(path, format='GIF')",
        "torch.save(weights, path)",
    ],
)
def test_a_direct_write_is_found_at_the_top_and_in_a_function(line: str) -> None:
    assert list(direct_writes(ast.parse(line))) == [1]
    assert list(direct_writes(ast.parse(f"def f(path):\n    with other(path) as temporary:\n        {line}"))) == [3]


@pytest.mark.parametrize(
    "body",
    [
        "with atomic_path(path) as part:\n        figure.savefig(part)",
        "with atomic_path(path) as part, part.open('wb') as file:\n        np.save(file, array)",
        "buffer = io.BytesIO()\n    np.save(buffer, array)",
        "write_text(path, 'x')",
        "path.open('rb')",
        "open(path)",
        "json.dump(value, sys.stdout)",
        "policy.save(folder)",
        "os.open(path, flags)",
    ],
)
def test_what_is_no_direct_write_is_left_alone(body: str) -> None:
    assert list(direct_writes(ast.parse(f"def f(path):\n    {body}"))) == []
