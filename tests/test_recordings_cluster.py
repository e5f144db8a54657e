"""Recording on a Dask cluster gives the bytes that recording here gives."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from mixo_env.errors import ConfigurationError
from mixo_env.recordings.processes import processes

SCRIPT = """
import sys
from pathlib import Path
from distributed import LocalCluster
from mixo_env.recordings.record import RecordConfig, record
from tests.recording_fakes import FAKES, FakeDataset, make_scene

if __name__ == "__main__":
    folder = Path(sys.argv[1])
    dataset = FakeDataset({f"scene-{n}": make_scene(folder, f"scene-{n}") for n in (2001, 2002, 2003)})
    record(dataset, RecordConfig(), folder / "here", experts=FAKES)
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        record(dataset, RecordConfig(), folder / "there", experts=FAKES, scheduler=cluster.scheduler_address)
"""


@pytest.mark.integration
def test_a_cluster_records_the_same(tmp_path):
    pytest.importorskip("distributed")
    (tmp_path / "script.py").write_text(SCRIPT)
    command = [sys.executable, str(tmp_path / "script.py"), str(tmp_path)]
    root = Path(__file__).parent.parent
    done = subprocess.run(command, cwd=root, env={"PYTHONPATH": str(root)}, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for name in ("recordings.parquet", "manifest.json"):
        assert (tmp_path / "here" / name).read_bytes() == (tmp_path / "there" / name).read_bytes()


def test_a_scheduler_that_is_not_there_is_one_clear_error():
    with (
        pytest.raises(ConfigurationError, match=r"no Dask scheduler at tcp://127|pip install"),
        processes(1, "tcp://127.0.0.1:1"),
    ):
        pass
