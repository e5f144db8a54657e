"""The failure suite end to end on two short drives, and what it refuses."""

import json
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from experiments import failures, failures_table
from experiments.failures import KINDS, SEEDS, STAGED_KINDS, Failures
from experiments.failures_table import REFERENCES, Scored, check_experts, score, write_tables
from experiments.mixocity import CONFIG
from mixo_env.errors import ConfigurationError, DatasetError, PolicyError
from mixo_env.experts.monocular.config import MonocularConfig
from mixo_env.policies.single import Single
from mixo_env.recordings.camera_faults import CAMERA_FAULTS, told_faults
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.store import load_recordings
from mixo_env.simulator.config import FAULTS
from mixo_env.simulator.drive.scenario import plan_logs

pytestmark = pytest.mark.rendering

ROWS = ("CAM_FRONT", "JOINT", "LINEAR", "HUBER")
KINDS_HERE = ("ordinary", "black")


def headline() -> Recordings:
    """The bundled headline as if today's experts had recorded it."""
    bundled = load_recordings()
    parameters = dict(bundled.manifest.parameters) | {"monocular": asdict(MonocularConfig.preset("fast"))}
    return bundled.replace(replace(bundled.manifest, parameters=parameters))


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Failures]:
    root = tmp_path_factory.mktemp("failures")
    made = Failures(
        root,
        root / "out",
        kinds=KINDS_HERE,
        policies=ROWS,
        scenes=2,
        seconds=5,
        width=160,
        workers=1,
        samples=root / "samples",
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            failures, "load_recordings", lambda source=None: load_recordings(source) if source else headline()
        )
        made.run()
        yield made


def test_kinds_are_sixteen_scenes_of_sixteen_logs_with_one_difficulty_each() -> None:
    for kind in KINDS:
        config = Failures().config(kind)
        logs = plan_logs(config)
        assert [len(log.scenes) for log in logs] == [1] * 16
        situations = {log.scenes[0].situation for log in logs}
        assert situations == {{"low_texture": "ordinary"}.get(kind, STAGED_KINDS.get(kind, ("ordinary",))[0])}
        assert {log.weather for log in logs} == {"rain" if kind.endswith("_rain") else "day"}
        assert config.fault.kind == ("none" if kind in STAGED_KINDS else kind)


def test_headline_table_and_development_drives_differ() -> None:
    seeds = [{Failures(drives=drives).seed(kind) for kind in KINDS} for drives in SEEDS]  # type: ignore[arg-type]
    assert not set.intersection(*seeds)
    assert CONFIG.seed not in set.union(*seeds)
    assert Failures(drives="development").folder("black") != Failures().folder("black")


def test_situations_share_no_drive_and_faults_have_the_ordinary_ones() -> None:
    logs = {kind: plan_logs(Failures().config(kind)) for kind in STAGED_KINDS}
    cities = [log.world_seed for of in logs.values() for log in of]
    assert len(set(cities)) == 16 * len(STAGED_KINDS)
    motions = [log.scenes[0].motion for of in logs.values() for log in of]
    assert len(set(motions)) == len(motions)
    for kind in FAULTS[1:]:
        config = Failures().config(kind)
        assert config == replace(Failures().config("ordinary"), fault=config.fault)


def test_pictures_go_when_nothing_needs_them(suite: Failures) -> None:
    assert not (suite.folder("black") / "images").exists()
    assert (suite.folder("ordinary") / "images" / "samples").exists()  # other faults are to come
    assert all(suite.recorded(kind) for kind in KINDS_HERE)


def test_a_fault_is_in_the_manifest_and_leaves_truth_and_other_cameras_alone(suite: Failures) -> None:
    sound, faulty = (load_recordings(str(suite.folder(kind) / "recordings")) for kind in KINDS_HERE)
    told = faulty.manifest.parameters[CAMERA_FAULTS]
    assert {name: fault["kind"] for name, fault in told.items()} == {s.name: "black" for s in faulty.scenes}
    assert CAMERA_FAULTS not in sound.manifest.parameters
    for scene in sound.scenes:
        before, after = sound.rows(scene.name), faulty.rows(scene.name)
        for column in before:
            owner = column.split(".")[0]
            if owner not in (told[scene.name]["camera"], "JOINT"):
                np.testing.assert_array_equal(before[column], after[column], err_msg=column)
        camera = told[scene.name]["camera"]
        assert (np.nan_to_num(before[f"{camera}.matches"]) != np.nan_to_num(after[f"{camera}.matches"])).any()


def test_the_matrix_is_what_the_report_reads(suite: Failures) -> None:
    found = json.loads((suite.out / "failures.json").read_text())
    assert found["data_version"] == headline().manifest.data_version
    assert (found["track"], found["scenes"], found["privileged"]) == ("VISION", dict.fromkeys(KINDS_HERE, 2), [])
    assert set(found["matrix"]) == set(ROWS)
    for row in found["matrix"].values():
        assert list(row) == list(KINDS_HERE)
        assert all(isinstance(value, float) for value in row.values())
    assert len({row["ordinary"] for row in found["matrix"].values()}) == len(ROWS)  # JOINT by its own columns
    text = (suite.out / "failures.md").read_text()
    assert all(f"{kind}, 2 scenes" in text for kind in KINDS_HERE)
    assert (suite.out / "failures.png").read_bytes().startswith(b"\x89PNG")


def test_a_table_of_another_track_has_its_voters(suite: Failures, tmp_path: Path) -> None:
    recorded = {kind: load_recordings(str(suite.folder(kind) / "recordings")) for kind in KINDS_HERE}
    write_tables(recorded, headline(), tmp_path, (*ROWS, "INERTIAL"), "CONSUMER")
    alone, with_gyro = (json.loads((out / "failures.json").read_text()) for out in (suite.out, tmp_path))
    assert (alone["track"], with_gyro["track"]) == ("VISION", "CONSUMER")
    assert set(with_gyro["matrix"]) == {*ROWS, "INERTIAL"}
    assert alone["matrix"]["HUBER"] != with_gyro["matrix"]["HUBER"]  # five vote
    assert "track CONSUMER" in (tmp_path / "failures.md").read_text()


def test_a_few_scenes_go_beside_the_tests(suite: Failures) -> None:
    suite.sample("ordinary")
    whole = load_recordings(str(suite.folder("ordinary") / "recordings"))
    sample = load_recordings(str(suite.samples / "ordinary"))
    assert [path.name for path in suite.samples.iterdir()] == ["ordinary"]
    assert sample.scenes == whole.scenes[:2]


def test_scenes_beside_the_tests_are_of_the_table_and_whole() -> None:
    Failures(stages=("sample",))
    for other in ({"drives": "development"}, {"kinds": ("ordinary",)}):
        with pytest.raises(ConfigurationError, match="sample is of the drives of the table, "):
            Failures(stages=("record", "sample"), **other)


def test_a_second_run_changes_nothing(suite: Failures) -> None:
    before = {path: path.read_bytes() for path in suite.out.iterdir()}
    suite.run()
    assert before == {path: path.read_bytes() for path in suite.out.iterdir()}


def test_rows_are_compared_with_the_references_and_corrected_together(suite: Failures) -> None:
    recordings = load_recordings(str(suite.folder("black") / "recordings"))
    policies = {name: Single(name) for name in recordings.manifest.cameras}
    for policy in policies.values():
        policy.start(recordings.voters("VISION"))
    scored = score(policies, recordings)
    assert {pair[1] for pair in scored.compared} <= set(REFERENCES)
    assert len(scored.compared) == len(recordings.manifest.cameras) - 1
    assert all(scored.p_holm[pair] >= found.p_value for pair, found in scored.compared.items())
    assert scored.ratio(scored.best_camera[0]) == 1.0
    assert min(scored.ratio(name) for name in policies) == 1.0


def test_a_suite_of_other_experts_is_one_line(suite: Failures) -> None:
    ours = headline()
    for change, message in (
        ({"features": 3}, "recorded with monocular features 3"),
        ({"apart_s": None}, "apart_s 0.3, "),
    ):
        monocular = ours.manifest.parameters["monocular"] | change
        old = {key: value for key, value in monocular.items() if value is not None}
        other = ours.replace(replace(ours.manifest, parameters=ours.manifest.parameters | {"monocular": old}))
        recorded, fitted_on = (other, ours) if "features" in change else (ours, other)
        with pytest.raises(PolicyError, match=f"black: .*{message}") as caught:
            write_tables({"black": recorded}, fitted_on, suite.out)
        assert "\n" not in str(caught.value)
    fewer = load_recordings(str(suite.folder("black") / "recordings"))
    fewer = fewer.replace(replace(fewer.manifest, cameras=fewer.manifest.cameras[::-1]))
    with pytest.raises(PolicyError, match="vote here"):
        check_experts(fewer, ours, "black")
    check_experts(ours, ours, "black")


def test_scenes_too_short_for_a_score_are_one_line_and_write_nothing(
    suite: Failures, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recordings = load_recordings(str(suite.folder("black") / "recordings"))
    nothing = Scored(dict.fromkeys(ROWS, float("nan")), {}, {}, ("CAM_FRONT", float("nan")), 2, frozenset())
    monkeypatch.setattr(failures_table, "score", lambda policies, suite, track: nothing)
    with pytest.raises(ConfigurationError, match="black: no scene of 2 is as long"):
        write_tables({"black": recordings}, headline(), tmp_path, ROWS)
    assert not list(tmp_path.iterdir())


def test_an_unknown_kind_is_one_line(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with pytest.raises(ConfigurationError, match="did you mean 'black'"):
        Failures(kinds=("blak",))
    assert failures.main(["--kinds", "blak", "--cache", str(tmp_path)]) == 1
    assert caplog.messages[-1].startswith("unknown kind of failure 'blak'")
    with pytest.raises(ConfigurationError, match="did you mean 'VISION'"):
        Failures(track="VISON")


def test_a_damaged_note_of_faults_is_one_line_and_a_real_folder_has_none(tmp_path: Path) -> None:
    assert told_faults(tmp_path) == {}
    for damaged in ('{"faults": {"scene', '{"faults": [1]}', "[]"):
        (tmp_path / "simulation.json").write_text(damaged)
        with pytest.raises(DatasetError, match=r"simulation\.json"):
            told_faults(tmp_path)
