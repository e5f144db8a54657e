"""The wheel and the sdist hold every data file, and the wheel works where no source tree is near."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGES = ("mixo_env",)
PIECE = "mixo_env/policies/weights/COVARIANCE INTERSECTION/VISION/all-folds-seed-0/policy.safetensors"

pytestmark = pytest.mark.integration


def run(*command: str, cwd: Path) -> str:
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def archives(tmp_path_factory):
    """The sdist, and the wheel built from it."""
    out, source = tmp_path_factory.mktemp("dist"), tmp_path_factory.mktemp("source") / "repository"
    # A copy without the egg-info of earlier builds, which would add whatever they had found.
    shutil.copytree(ROOT, source, ignore=shutil.ignore_patterns(".*", "*.egg-info", "__pycache__", "build", "results"))
    piece = source / PIECE  # as `make weights` writes them, whether or not any are there
    piece.parent.mkdir(parents=True, exist_ok=True)
    piece.touch()
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", str(out), str(source), cwd=out)
    (wheel,), (sdist,) = out.glob("*.whl"), out.glob("*.tar.gz")
    return wheel, sdist


def source_files() -> set[str]:
    """Everything in the packages that is not made by running them."""
    return {
        str(path.relative_to(ROOT))
        for package in PACKAGES
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }


def test_both_archives_hold_every_file_of_the_packages(archives):
    wheel, sdist = archives
    with zipfile.ZipFile(wheel) as archive:
        in_wheel = set(archive.namelist())
    with tarfile.open(sdist) as archive:
        in_sdist = {name.partition("/")[2] for name in archive.getnames()}
    expected = source_files()
    assert {"mixo_env/py.typed", "mixo_env/recordings/data/mixocity/recordings.parquet"} <= expected
    expected |= {PIECE}
    assert expected - in_wheel == set()
    assert expected - in_sdist == set()
    assert {"LICENSE", "README.md", "pyproject.toml"} <= in_sdist
    assert not [name for name in in_wheel if name.startswith("tests/")]


def test_the_wheel_owns_one_name(archives):
    """A wheel that owned ``baselines`` or ``experiments`` would break users' own folders of these names."""
    with zipfile.ZipFile(archives[0]) as archive:
        tops = {name.partition("/")[0] for name in archive.namelist()}
    assert {name for name in tops if not name.endswith(".dist-info")} == {"mixo_env"}
    assert len(tops) == 2


def test_the_sdist_holds_the_repository(archives):
    with tarfile.open(archives[1]) as archive:
        in_sdist = {name.partition("/")[2] for name in archive.getnames()}
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode:
        pytest.skip("needs the repository's own list of files")
    wanted = {
        f for f in listed.stdout.split() if f.split("/")[0] in ("baselines", "docs", "examples", "experiments", "tests")
    }
    assert {f.split("/")[0] for f in wanted} == {"baselines", "docs", "examples", "experiments", "tests"}
    assert wanted - in_sdist == set()


def test_the_wheel_works_in_a_clean_virtual_environment(archives, tmp_path):
    wheel, _ = archives
    python = tmp_path / "venv" / "bin" / "python"
    run(sys.executable, "-m", "venv", "--without-pip", str(tmp_path / "venv"), cwd=tmp_path)
    run(sys.executable, "-m", "pip", "--python", str(python), "install", "--no-deps", str(wheel), cwd=tmp_path)
    # Dependencies are borrowed; the source tree, installed beside them in editable mode, is not seen through a path.
    site = Path(run(str(python), "-c", "import site; print(site.getsitepackages()[0])", cwd=tmp_path).strip())
    borrowed = [path for path in sys.path if path.endswith("site-packages")]
    (site / "borrowed.pth").write_text("\n".join(borrowed) + "\n")
    code = (
        "import mixo_env; from mixo_env.recordings.store import load_recordings; "
        "print(mixo_env.__file__, len(load_recordings()))"
    )
    project = tmp_path / "project"  # whose folders have names that are ours in the source tree
    for name in ("experiments", "baselines"):
        (project / name).mkdir(parents=True)
        (project / name / "__init__.py").write_text("raise RuntimeError('not ours')\n")
    where, scenes = run(str(python), "-c", code, cwd=project).split()
    assert Path(where).is_relative_to(site)
    assert int(scenes) >= 12
    assert "benchmark" in run(str(python.with_name("mixo")), "--help", cwd=project)
