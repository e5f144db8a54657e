"""The plan of the bundled recordings: what the benchmark is measured on."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from experiments import mixocity
from experiments.mixocity import CONFIG, FULL_SIZE, full_size_scenes, planned_folds, row_scenes
from mixo_env.errors import DatasetError
from mixo_env.experts.families import family_expert
from mixo_env.experts.monocular.config import MonocularConfig
from mixo_env.leaderboard.trajectories import ways, write_way
from mixo_env.nuscenes.selections import CAMERAS
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.folds import FOLDS, OUT_OF_DISTRIBUTION, folds_by_log
from mixo_env.recordings.schema import SceneEntry
from mixo_env.recordings.store import TIMINGS_FILE, load_recordings, read_columns, save_recordings, write_columns
from mixo_env.simulator.drive.scenario import plan_logs
from mixo_env.simulator.drive.scenes import scene_drive
from tests.synthetic import synthetic_recordings


def test_scenes_weather_and_folds():
    logs = plan_logs(CONFIG)
    assert (len(logs), CONFIG.cameras, CONFIG.seconds) == (86, CAMERAS, 20)
    assert Counter(log.weather for log in logs) == {"day": 63, "rain": 17, "night": 6}
    assert len({log.world_seed for log in logs}) == 86
    fold_of = planned_folds()
    assert Counter(fold_of.values()) == {0: 80, 1: 80, 2: 80, 3: 80, OUT_OF_DISTRIBUTION: 24}
    for fold in range(FOLDS):
        inside = [log for log in logs if {fold_of[scene.name] for scene in log.scenes} == {fold}]
        assert len(inside) == 20
        assert {log.weather for log in inside} == {"day", "rain"}
        assert Counter(log.vehicle for log in inside) == {"m001": 10, "m002": 10}


def test_further_rows_stand_on_28_drives_and_the_rule_of_the_folds_says_the_same_of_them_alone():
    names, fold_of = row_scenes(), planned_folds()
    log_of = {scene.name: log for log in plan_logs(CONFIG) for scene in log.scenes}
    assert len({log_of[name].logfile for name in names}) == len(names) == 28
    alone = [SceneEntry(n, log_of[n].logfile, log_of[n].vehicle, "", (log_of[n].weather,), -1, 0) for n in names]
    assert folds_by_log(alone) == [fold_of[name] for name in names]
    assert Counter(fold_of[name] for name in names) == dict.fromkeys(range(FOLDS), 7)
    assert Counter(log_of[name].vehicle for name in names) == {"m001": 16, "m002": 12}


def test_every_situation_is_staged_and_most_scenes_are_ordinary():
    logs = plan_logs(CONFIG)
    staged = Counter(scene.situation for log in logs for scene in log.scenes)
    assert set(staged) == {*CONFIG.situations.by_name(), "ordinary"} - {"majority_wrong"}
    assert min(staged.values()) >= 4
    assert staged["ordinary"] > CONFIG.scenes / 2
    by_day = {scene.situation for log in logs if log.weather != "night" for scene in log.scenes}
    assert by_day == set(staged)
    assert {log.weather for log in logs if log.low_texture} >= {"day"}


def test_full_size_scenes_are_the_same_drives():
    names = full_size_scenes()
    assert set(names) < set(row_scenes())
    small, large = (
        {scene.name: (log, scene) for log in plan_logs(config) for scene in log.scenes}
        for config in (CONFIG, FULL_SIZE)
    )
    assert len(names) == 8
    for name in names:
        (log, plan), (other, same) = small[name], large[name]
        assert plan == same
        for field in ("logfile", "vehicle", "weather", "world_seed", "sensors", "course_offset_rad"):
            assert repr(getattr(log, field)) == repr(getattr(other, field))
        for camera, true in log.rig.true.items():
            twice = other.rig.true[camera]
            assert np.array_equal(true.translation_m, twice.translation_m)
            assert np.array_equal(true.rotation_ego_from_camera, twice.rotation_ego_from_camera)
            scaled = 2 * (true.intrinsic[:2, 2] + 0.5) - 0.5
            assert twice.intrinsic[:2, 2] == pytest.approx(scaled, abs=1e-9)
    log, plan = small[names[0]]
    other, same = large[names[0]]
    one, two = scene_drive(CONFIG, log, plan), scene_drive(FULL_SIZE, other, same)
    assert np.array_equal(one.x_m, two.x_m)
    assert np.array_equal(one.yaw_rad, two.yaw_rad)
    assert Counter(planned_folds()[name] for name in names) == dict.fromkeys(range(FOLDS), 2)


@pytest.fixture
def stages(monkeypatch) -> list[tuple]:
    """The build without its hours: what was asked of every stage."""
    asked: list[tuple] = []
    drawn = synthetic_recordings(0)
    entries = zip(drawn.scenes, full_size_scenes(), strict=True)
    scenes = tuple(replace(scene, name=name, fold=-1) for scene, name in entries)

    def record(dataset, config, out, workers, progress) -> Recordings:
        assert out.parent == dataset.parent
        asked.append(("record", dataset.name, out.name, config))
        out.mkdir(parents=True)
        names = [*full_size_scenes(), "scene-2002"]  # the last is not the first of its drive
        timings = {"scene": np.array(names, object), "expert_ms": np.arange(float(len(names)))}
        write_columns(out / TIMINGS_FILE, timings, [len(names)])
        return drawn.replace(replace(drawn.manifest, scenes=scenes, parameters={"skipped": {}}))

    monkeypatch.setattr("mixo_env.recordings.record.require_xfeat", lambda: None)
    monkeypatch.setattr(mixocity, "simulate", lambda *given, **only: asked.append(("simulate", *given[:3], only)))
    monkeypatch.setattr(
        mixocity,
        "retrain",
        lambda dataset, cameras, *_, scenes, **__: asked.append(("retrain", cameras, scenes)) or {},
    )
    monkeypatch.setattr(mixocity, "orbslam3_python", lambda: None)
    monkeypatch.setattr(mixocity, "open_dataset", lambda root: root)
    monkeypatch.setattr(mixocity, "record", record)
    return asked


def test_stages_in_order(stages, tmp_path):
    cache, out = tmp_path / "cache", tmp_path / "data"
    mixocity.Build(cache=cache, out=out, workers=3).run()
    assert [stage[0] for stage in stages] == [
        "simulate", "record", "retrain", "retrain", "record", "simulate", "record"
    ]  # fmt: skip
    assert stages[0] == ("simulate", CONFIG, cache / "city", 3, {})
    assert stages[5] == ("simulate", FULL_SIZE, cache / "full-size", 3, {"only": full_size_scenes()})
    assert stages[2] == ("retrain", mixocity.RETRAINED, row_scenes())
    (_, *whole), (_, *rows), (_, *paper) = (stage for stage in stages if stage[0] == "record")
    assert [where for *where, _ in (whole, rows, paper)] == [
        ["city", "mixocity"], ["city", "mixocity-rows"], ["full-size", "mixocity-paper"]
    ]  # fmt: skip
    assert [config.data_version for *_, config in (whole, rows, paper)] == [
        f"{name}-{mixocity.DATA_VERSION}" for name in ("mixocity", "mixocity-rows", "mixocity-paper")
    ]
    assert (whole[-1].scenes, list(whole[-1].recorded_variants())) == ((), ["JOINT"])
    assert rows[-1].scenes == row_scenes()
    further = {"JOINT", *(family_expert(family, camera) for family in ("TUTORIAL", "LEARNED") for camera in CAMERAS)}
    assert set(rows[-1].recorded_variants()) == further
    assert whole[-1].monocular == rows[-1].monocular == MonocularConfig.preset("fast")
    assert paper[-1].monocular == MonocularConfig.preset("paper")
    put = load_recordings(out / "mixocity-paper")
    assert {scene.name: scene.fold for scene in put.scenes} == {
        name: planned_folds()[name] for name in full_size_scenes()
    }
    assert set(put.manifest.linear_weights["PAPER"]) == {"none", "0", "1", "2", "3"}
    timings, _, _ = read_columns((out / "mixocity-paper" / TIMINGS_FILE).read_bytes())
    assert timings["scene"].tolist() == list(full_size_scenes())


def test_one_stage_alone_and_wrong_ones(stages, tmp_path, monkeypatch, caplog):
    monkeypatch.setattr("sys.argv", ["mixocity", "--stages", "vocabularies", "--cache", str(tmp_path)])
    assert mixocity.main() == 0
    assert [stage[0] for stage in stages] == ["retrain"]
    monkeypatch.setattr("sys.argv", ["mixocity", "--stages", "vocabulary"])
    with pytest.raises(SystemExit):
        mixocity.main()


def test_a_recording_that_is_not_whole_is_not_put_in_place(stages, tmp_path, monkeypatch):
    whole = mixocity.record

    def broken(*given) -> Recordings:
        recordings = whole(*given)
        return recordings.replace(replace(recordings.manifest, parameters={"skipped": {"scene-2001": "no CAN bus"}}))

    monkeypatch.setattr(mixocity, "record", broken)
    with pytest.raises(DatasetError, match="not whole: 1 scenes"):
        mixocity.Build(cache=tmp_path, out=tmp_path / "data", stages=("record",)).run()
    assert not (tmp_path / "data").exists()


def test_the_peer_comes_beside_the_other_rows_and_again_in_its_own_place(tmp_path, monkeypatch):
    drawn = synthetic_recordings(0, scenes=4)
    save_recordings(drawn, tmp_path / "data" / "mixocity-rows")

    @dataclass
    class Peer:
        dataroot: Path
        out: Path
        scenes: tuple[str, ...]

        def run(self) -> int:
            assert self.scenes == row_scenes()
            for way in ways(drawn, "VISION"):
                if way.row in CAMERAS:
                    write_way(self.out, replace(way, row=family_expert("ORBSLAM3", way.row)), "tum")
            return 0

    monkeypatch.setattr(mixocity, "orbslam3_python", lambda: Path("python"))
    monkeypatch.setattr(mixocity, "Orbslam3Expert", Peer)
    build = mixocity.Build(cache=tmp_path / "cache", out=tmp_path / "data", stages=("import-peer",))
    for _ in range(2):
        build.run()
        put = load_recordings(tmp_path / "data" / "mixocity-rows")
        assert put.manifest.imported == tuple(family_expert("ORBSLAM3", camera) for camera in CAMERAS)
        assert put.voters("VISION") == drawn.voters("VISION")
        told = np.isfinite(put["ORBSLAM3_FRONT.yaw_increment_rad"])
        assert told.mean() > 0.9
