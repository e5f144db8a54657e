"""A Dask cluster records the same bytes, with a worker killed too; a scene that always kills is skipped."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from mixo_env.errors import ConfigurationError
from mixo_env.recordings.processes import each

SCRIPT = """
import os, signal, sys
import dask
from dataclasses import replace
from functools import partial
from pathlib import Path
from distributed import LocalCluster
from mixo_env.recordings.processes import KILLED
from mixo_env.recordings.record import RecordConfig, record
from tests.recording_fakes import FAKES, FakeCamera, FakeDataset, make_scene, write_picture


class Fatal(FakeCamera):
    def process(self, image, timestamp_us, distance_m):
        if round(float(image.mean())) == 131:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().process(image, timestamp_us, distance_m)


class Deadly(FakeCamera):
    def __init__(self, calibration, lives):
        super().__init__(calibration)
        if left := int(lives.read_text() or 0):
            lives.write_text(str(left - 1))
            os.kill(os.getpid(), signal.SIGKILL)


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    dataset = FakeDataset({f"scene-{n}": make_scene(folder, f"scene-{n}") for n in (2001, 2002, 2003)})
    record(dataset, RecordConfig(), folder / "here", experts=FAKES)
    dask.config.set({"distributed.scheduler.allowed-failures": 0})  # few restarts
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        record(dataset, RecordConfig(), folder / "there", experts=FAKES, scheduler=cluster.scheduler_address)
        (folder / "lives").write_text("1")
        experts = replace(FAKES, camera=partial(Deadly, lives=folder / "lives"))
        record(dataset, RecordConfig(), folder / "killed", experts=experts, scheduler=cluster.scheduler_address)
        assert (folder / "lives").read_text() == "0"
        for name, scene in dataset.scenes.items():
            for path in scene.cameras["CAM_FRONT"].image_paths:
                write_picture(path, 131 if name == "scene-2002" else 90)
            for camera in ("CAM_FRONT_LEFT", "CAM_BACK", "CAM_BACK_RIGHT"):
                for path in scene.cameras[camera].image_paths:
                    write_picture(path, 200)
        experts = replace(FAKES, camera=Fatal)
        address = cluster.scheduler_address
        always = record(dataset, RecordConfig(), folder / "always", experts=experts, scheduler=address)
        assert [scene.name for scene in always.scenes] == ["scene-2001", "scene-2003"]
        assert always.manifest.parameters["skipped"] == {"scene-2002": KILLED}
"""


@pytest.mark.faults
def test_a_cluster_records_the_same_with_a_worker_killed_and_all_but_the_scene_that_always_kills(tmp_path):
    pytest.importorskip("distributed")
    (tmp_path / "script.py").write_text(SCRIPT)
    command = [sys.executable, str(tmp_path / "script.py"), str(tmp_path)]
    root = Path(__file__).parent.parent
    done = subprocess.run(command, cwd=root, env={"PYTHONPATH": str(root)}, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for name in ("recordings.parquet", "manifest.json"):
        here = (tmp_path / "here" / name).read_bytes()
        assert (tmp_path / "there" / name).read_bytes() == here
        assert (tmp_path / "killed" / name).read_bytes() == here


def test_a_scheduler_that_is_not_there_is_one_clear_error():
    with (
        pytest.raises(ConfigurationError, match=r"no Dask scheduler at tcp://127|pip install"),
    ):
        list(each(print, {"task": ()}, 1, "tcp://127.0.0.1:1"))
