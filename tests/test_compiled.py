"""Machine code on disk is never older than a source it was made of, and a place to keep it is not needed."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mixo_env import compiled

PACKAGE = Path(compiled.__file__).parent
SOURCES = sorted(PACKAGE.rglob("*.py"))

# Twice the least distance of kinematics.py, through a function and a constant of that file.
FACTOR = "FACTOR = 2.0"
PROBE = """
from mixo_env.compiled import compiled
from mixo_env.factor import FACTOR
from mixo_env.kinematics import never_zero

@compiled
def scaled(distance: float) -> float:
    return FACTOR * never_zero(distance)

def measure(_: int = 0) -> tuple[float, int]:
    return scaled(0.0), sum(scaled.stats.cache_hits.values())
"""

HERE = "from mixo_env.probe import measure; print(*measure())"
LOKY = """
from joblib import Parallel, delayed
from mixo_env.probe import measure
print(*Parallel(n_jobs=2, backend="loky")([delayed(measure)(0)])[0])
"""
SPAWN = """
import multiprocessing
from mixo_env.probe import measure
if __name__ == "__main__":
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        print(*pool.map(measure, [0])[0])
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A folder with a package ``mixo_env`` of two compiled functions."""
    package = tmp_path / "checkout" / "mixo_env"
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    for name in ("compiled.py", "caches.py", "experts/monocular/kinematics.py"):
        shutil.copy(PACKAGE / name, package)
    (package / "factor.py").write_text(FACTOR, encoding="utf-8")
    (package / "probe.py").write_text(PROBE, encoding="utf-8")
    return package.parent


def run(checkout: Path, code: str, **variables: str) -> list[str]:
    """What a new process prints, in words. Its caches lie beside the checkout; byte code is not kept."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}
    environment |= {"PYTHONPATH": str(checkout), "PYTHONDONTWRITEBYTECODE": "1", "OMP_NUM_THREADS": "1"}
    environment |= {"XDG_CACHE_HOME": str(checkout.parent / "cache")} | variables
    done = subprocess.run([sys.executable, "-c", code], env=environment, cwd=checkout, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def edit(checkout: Path, old: str, new: str) -> None:
    """Replace a constant of kinematics.py."""
    path = checkout / "mixo_env" / "kinematics.py"
    text = path.read_text(encoding="utf-8")
    assert f"_STILL_M = {old}" in text
    path.write_text(text.replace(f"_STILL_M = {old}", f"_STILL_M = {new}"), encoding="utf-8")


def machine_code(folder: Path) -> list[Path]:
    return list(folder.rglob("*.nb[ic]"))


@pytest.mark.parametrize("code", [HERE, LOKY, SPAWN], ids=["here", "loky", "spawn"])
def test_an_edited_constant_of_another_file_moves_the_value_and_undoing_moves_it_back(
    checkout: Path, code: str
) -> None:
    assert run(checkout, code) == ["0.0002", "0"]
    edit(checkout, "1e-4", "1e-2")
    assert run(checkout, code) == ["0.02", "0"]
    edit(checkout, "1e-2", "1e-4")
    assert run(checkout, code) == ["0.0002", "1"]  # the first machine code, found again
    assert not machine_code(checkout)


@pytest.mark.parametrize(
    ("module", "old", "new", "value"),
    [("kinematics", "_STILL_M = 1e-4", "_STILL_M = 1e-2", "0.02"), ("factor", FACTOR, "FACTOR = 4.0", "0.0004")],
    ids=["with functions", "constants only"],
)
def test_a_source_edited_while_the_process_runs_leaves_nothing_stale_behind(
    checkout: Path, module: str, old: str, new: str, value: str
) -> None:
    late = f"""
from pathlib import Path
import mixo_env.compiled, mixo_env.{module}
path = Path(mixo_env.{module}.__file__)
path.write_text(path.read_text().replace({old!r}, {new!r}))
from mixo_env.probe import measure
print(*measure())
"""
    assert run(checkout, late) == ["0.0002", "0"]  # what was imported
    assert run(checkout, HERE) == [value, "0"]  # what is on disk


def test_a_process_that_can_write_nowhere_compiles_and_keeps_nothing(checkout: Path) -> None:
    (checkout / "mixo_env" / "__pycache__").touch()  # a file: no folder can be made there
    for nowhere in ({"XDG_CACHE_HOME": "", "HOME": os.devnull}, {"NUMBA_CACHE_DIR": os.devnull}):
        assert run(checkout, HERE, **nowhere) == ["0.0002", "0"]
    assert not machine_code(checkout.parent)


def test_without_a_cache_numba_does_not_write_beside_the_sources(checkout: Path) -> None:
    assert run(checkout, HERE, XDG_CACHE_HOME=os.devnull, HOME=str(checkout)) == ["0.0002", "0"]
    assert not machine_code(checkout.parent)


def test_the_environment_works_from_a_package_and_a_home_that_cannot_be_written(tmp_path: Path) -> None:
    package = tmp_path / "checkout" / "mixo_env"
    data = [folder for folder in PACKAGE.rglob("data") if folder.is_dir()]
    shutil.copytree(PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__", "data"))
    for folder in data:
        (package / folder.relative_to(PACKAGE)).symlink_to(folder)
    for folder in {path.parent for path in package.rglob("*.py")}:
        (folder / "__pycache__").touch()
    code = """
import gymnasium
env = gymnasium.make("mixo_env:MixoOdometry-v0")
env.reset(seed=0)
_, reward, *_ = env.step(env.action_space.high)
print(env.unwrapped.__module__, reward < 0.0)
import mixo_env
print(mixo_env.__file__)
"""
    printed = run(package.parent, code, XDG_CACHE_HOME="", HOME=os.devnull)
    assert printed == ["mixo_env.envs.odometry", "True", str(package / "__init__.py")]


def test_the_users_own_folder_is_used_and_other_packages_stay_where_they_were(checkout: Path) -> None:
    (checkout / "other.py").write_text(
        "import numba\nfrom mixo_env.probe import measure\nmeasure()\n"
        "@numba.njit(cache=True)\ndef other():\n    return 1.0\n",
        encoding="utf-8",
    )
    code = "import other; print(other.other(), other.other.stats.cache_path)"
    own = checkout.parent / "own"
    _, path = run(checkout, code, NUMBA_CACHE_DIR=str(own))
    assert Path(path).parent == own
    assert {file.relative_to(own).parts[0].split("-")[0] for file in machine_code(own)} == {
        "mixo_env.kinematics",
        "mixo_env.probe",
        Path(path).name.split("-")[0],
    }
    assert machine_code(checkout.parent) == machine_code(own)
    _, path = run(checkout, code)
    assert Path(path) == checkout / "__pycache__"
    assert {file.parent for file in machine_code(checkout)} == {checkout / "__pycache__"}


def test_a_locator_chosen_by_the_user_does_not_bring_back_the_cache_beside_the_sources(checkout: Path) -> None:
    assert run(checkout, HERE, NUMBA_CACHE_LOCATOR_CLASSES="InTreeCacheLocator") == ["0.0002", "0"]
    assert not machine_code(checkout)
    assert machine_code(checkout.parent / "cache" / "mixo-env" / "numba")


def test_division_by_zero_is_an_error_or_infinite_as_the_decorator_says(checkout: Path) -> None:
    code = """
from mixo_env.compiled import compiled, compiled_unchecked, inlined
@compiled
def checked(x):
    return 1.0 / x
@compiled_unchecked
def unchecked(x):
    return 1.0 / x
@inlined
def within(x):
    return 1.0 / x
print(unchecked(0.0), within(-0.0))
try:
    checked(0.0)
except ZeroDivisionError:
    print("error")
"""
    assert run(checkout, code) == ["inf", "-inf", "error"]


def test_loops_for_both_speeds_are_imported_without_numba(checkout: Path) -> None:
    code = "import sys, mixo_env.compiled; print('numba' in sys.modules)"
    assert run(checkout, code) == ["False"]
    assert run(PACKAGE.parent, code.replace("compiled", "metrics.relative")) == ["False"]


def test_folders_unused_for_a_week_are_thrown_away_and_no_others(tmp_path: Path) -> None:
    def made(name: str, days: float) -> Path:
        folder = tmp_path / name
        (folder / "inner").mkdir(parents=True)
        then = time.time() - days * 86400.0
        os.utime(folder, (then, then))
        return folder

    old, recent, foreign = made("mixo_env.gone-0", 8.0), made("mixo_env.a.b-1", 6.0), made("numba_2", 8.0)
    source = PACKAGE / "experts" / "monocular" / "kinematics.py"
    folder = compiled.cache_folder.__wrapped__(source, str(tmp_path))
    assert folder is not None
    assert sorted(tmp_path.iterdir()) == sorted([folder, recent, foreign])
    assert not old.exists()
    os.utime(folder, (0.0, 0.0))
    assert compiled.cache_folder.__wrapped__(source, str(tmp_path)) == folder
    assert time.time() - folder.stat().st_mtime < 3600.0  # use keeps it young


def test_a_user_without_a_home_has_no_place_for_caches(monkeypatch: pytest.MonkeyPatch) -> None:
    def no_home() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(Path, "home", no_home)
    assert compiled.cache_folder.__wrapped__(PACKAGE / "geometry.py", "") is None


def test_the_closure_holds_imports_of_every_form_and_the_packages_around_them(checkout: Path) -> None:
    package = checkout / "mixo_env"
    for name in ("a", "b", "c", "d", "e", "unused", "deep/__init__", "deep/f", "deep/g"):
        path = package / f"{name}.py"
        path.parent.mkdir(exist_ok=True)
        path.write_text('"""Nothing, from mixo_env.unused or elsewhere."""\n', encoding="utf-8")
    (package / "a.py").write_text("def late():\n    from mixo_env.b import (\n        x,\n        y as z,\n    )\n")
    (package / "b.py").write_text("import math, mixo_env.c as c\nfrom mixo_env import \\\n    d\n")
    (package / "d.py").write_text("from mixo_env import (\n    e,\n)\nimport numpy\nimport mixo_env.a\n")  # a circle
    (package / "e.py").write_text("import mixo_env.deep.f as first, math\n")
    code = """
from pathlib import Path
from mixo_env.compiled import import_closure
root = Path("mixo_env").absolute()
print(*(path.relative_to(root).as_posix() for path in import_closure(root / "a.py")))
"""
    expected = ["__init__.py", "a.py", "b.py", "c.py", "d.py", "deep/__init__.py", "deep/f.py", "e.py"]
    assert run(checkout, code) == expected


def test_the_closure_misses_no_import_that_the_syntax_tree_has() -> None:
    for path in SOURCES:
        names: set[str] = set()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{path}: relative imports are not followed"
                names |= {str(node.module)} | {f"{node.module}.{alias.name}" for alias in node.names}
        stems = [PACKAGE.parent.joinpath(*name.split(".")) for name in names]
        candidates = {file for stem in stems for file in (stem.with_suffix(".py"), stem / "__init__.py")}
        missed = candidates & set(SOURCES) - set(compiled.import_closure(path))
        assert not missed, f"{path}: {missed}"


def test_nothing_is_compiled_but_through_the_one_module() -> None:
    compilers = {"njit", "jit", "vectorize", "guvectorize", "cfunc", "stencil", "jitclass", "generated_jit"}
    for path in SOURCES:
        used: set[str] = set()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Attribute):
                used.add(node.attr)
            elif isinstance(node, ast.Name):
                used.add(node.id)
            elif isinstance(node, ast.ImportFrom):
                used |= {alias.name for alias in node.names}
        if path == Path(compiled.__file__):
            assert used & compilers == {"njit"}
        else:
            assert not used & compilers, f"{path}: use mixo_env.compiled, numba alone keeps stale machine code"
