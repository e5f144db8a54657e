"""Recordings made from trajectories alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mixo_env.cli.main import main
from mixo_env.errors import ConfigurationError, TrajectoryError
from mixo_env.experts.expert import State
from mixo_env.recordings.sequence_files import Reading
from mixo_env.recordings.sequences import SequenceRules, constant_rate_columns, log_of, recordings_from_trajectories
from mixo_env.recordings.store import load_recordings
from mixo_env.trajectory import write_kitti, write_tum
from mixo_env.trajectory.text import read_numbers
from tests.odometry_files import RATE_HZ, drive, import_command, in_axes, write_set
from tests.trajectories import random_rotation

RATE = ("--rate", "10")


def made(folders: dict[str, Path], notes: list[str] | None = None, **rules):
    rules.setdefault("reading", Reading(rate_hz=RATE_HZ))
    experts = {name: folder for name, folder in folders.items() if name != "groundtruth"}
    heard = notes if notes is not None else []
    return recordings_from_trajectories(folders["groundtruth"], experts, SequenceRules(**rules), heard.append)


def expected(sequence: int) -> np.ndarray:
    way = drive(sequence)
    _, _, yaw = way.planar()
    return np.diff(yaw)


def test_a_command_makes_a_recording_that_opens(tmp_path, capsys):
    folders = write_set(tmp_path, {"A": 0.0, "B": 1e-3}, sequences=3)
    assert main(import_command(folders, tmp_path / "out", *RATE)) == 0
    said = capsys.readouterr().out
    assert "A in 3 of 3 scenes, 100.0% of the steps" in said
    assert "3 scenes, 477 steps, 3 logs, 3 folds; distance from truth (privileged)" in said
    assert "Only yaw is used" in said
    recordings = load_recordings(tmp_path / "out")
    assert [scene.name for scene in recordings.scenes] == ["drive00", "drive01", "drive02"]
    assert (recordings.experts, recordings.manifest.distance) == (("A", "B"), "truth")
    for i in range(3):
        rows = recordings.rows(i)
        np.testing.assert_allclose(rows["A.yaw_increment_rad"][1:], expected(i), atol=1e-6)
        np.testing.assert_allclose(rows["truth.yaw_increment_rad"][1:], expected(i), atol=1e-9)
        assert (rows["A.state"] == State.TRACKING).all()
        assert np.isnan(rows["A.matches"]).all()
        np.testing.assert_allclose(rows["distance_m"][1:], rows["truth.distance_m"][1:], rtol=1e-6)


@pytest.mark.parametrize("form", ["tum", "times folder", "times beside", "euroc", "subfolders", "index column"])
def test_every_layout_gives_the_same_rows(tmp_path, form):
    reference = made(write_set(tmp_path / "reference", {"A": 1e-3}, sequences=2))
    folders = write_set(tmp_path / "set", {"A": 1e-3}, sequences=2, form="tum" if form in ("tum", "euroc") else "kitti")
    reading = Reading()
    for name, folder in folders.items():
        for path in list(folder.glob("*.txt")):
            times = "".join(f"{k / RATE_HZ}\n" for k in range(160))
            if form == "times folder":
                (tmp_path / "times").mkdir(exist_ok=True)
                (tmp_path / "times" / path.name).write_text(times)
                reading = Reading(times=tmp_path / "times")
            elif form == "times beside" and name == "groundtruth":
                path.with_suffix(".times").write_text(times)
            elif form == "euroc":
                values = read_numbers(path).values[:, [0, 1, 2, 3, 7, 4, 5, 6]]
                target = folder / path.stem / "mav0" / "state_groundtruth_estimate0" / "data.csv"
                target.parent.mkdir(parents=True)
                heading = (
                    "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"
                )
                lines = [f"{round(1e9 * row[0])}," + ",".join(map(repr, row[1:])) for row in values.tolist()]
                target.write_text("\n".join([heading, *lines]) + "\n")
                path.unlink()
            elif form == "subfolders":
                (folder / path.stem).mkdir()
                path.rename(folder / path.stem / ("gt.txt" if name == "groundtruth" else "a.txt"))
                write_kitti(folder / path.stem / "other.txt", in_axes(drive(9), "camera"))
                reading = Reading(rate_hz=RATE_HZ)
            elif form == "index column":
                reading = Reading(rate_hz=RATE_HZ)
                if name == "A":
                    lines = path.read_text().splitlines()
                    path.write_text("\n".join(f"{k} {line}" for k, line in enumerate(lines)) + "\n")
    recordings = made(folders, reading=reading)
    assert [scene.name for scene in recordings.scenes] == ["drive00", "drive01"]
    for column in reference.column_names:
        np.testing.assert_allclose(recordings[column], reference[column], atol=1e-6, err_msg=column)


def test_local_turns_are_differenced_whatever_the_frame_of_a_file(tmp_path):
    folders = write_set(tmp_path, {"A": 0.0}, sequences=2)
    before = made(folders)
    for seed, folder in enumerate(folders.values()):
        for sequence in range(2):
            world = random_rotation(np.random.default_rng([seed, sequence]))
            write_kitti(folder / f"drive{sequence:02d}.txt", in_axes(drive(sequence), "camera", world))
    tilted = made(folders)
    for column in ("A.yaw_increment_rad", "truth.yaw_increment_rad", "truth.x_m", "truth.y_m", "distance_m"):
        np.testing.assert_allclose(tilted[column], before[column], atol=1e-5, err_msg=column)


def test_files_without_a_partner_are_said(tmp_path):
    folders = write_set(tmp_path, {"A": 0.0, "B": 0.0}, sequences=3)
    (folders["A"] / "drive01.txt").unlink()
    (folders["B"] / "drive02.txt").rename(folders["B"] / "other.txt")
    notes: list[str] = []
    recordings = made(folders, notes)
    assert "A: no file for drive01, lost there all the way" in notes
    assert "B, other: no ground truth of this name, left out" in notes
    assert (recordings.rows("drive01")["A.state"] == State.LOST).all()
    assert np.isnan(recordings.rows("drive01")["A.yaw_increment_rad"]).all()
    for path in folders["A"].glob("*.txt"):
        path.rename(path.with_stem(f"x{path.stem}"))
    with pytest.raises(TrajectoryError, match="A: expected files named after the ground truth's sequences, such as"):
        made(folders)


def test_an_expert_without_poses_around_a_step_is_lost_there(tmp_path):
    folders = write_set(tmp_path, {"A": 0.0}, sequences=1, form="tum")
    way = drive(0)
    kept = np.r_[10:60, 65:80, 100:160]  # gaps of 0.5 s (bridged) and 2 s (not)
    write_tum(folders["A"] / "drive00.txt", way[kept])
    rows = made(folders, reading=Reading()).rows(0)
    lost = np.flatnonzero(rows["A.state"] == State.LOST)
    assert np.isnan(rows["A.yaw_increment_rad"][1:11]).all()
    assert np.isfinite(rows["A.yaw_increment_rad"][11:80]).all()
    assert np.isnan(rows["A.yaw_increment_rad"][80:101]).all()
    assert np.isfinite(rows["A.yaw_increment_rad"][101:]).all()
    np.testing.assert_array_equal(lost, np.r_[0:11, 80:101])
    strict = made(folders, reading=Reading(), maximum_gap_s=0.3).rows(0)
    assert (strict["A.state"][60:66] == State.LOST).all()


def test_other_rates_are_interpolated(tmp_path):
    folders = write_set(tmp_path, {"A": 0.0}, sequences=1, form="tum")
    way = drive(0)
    write_tum(folders["A"] / "drive00.txt", way[np.arange(0, 160, 2)])
    notes: list[str] = []
    rows = made(folders, notes, reading=Reading()).rows(0)
    assert np.isfinite(rows["A.yaw_increment_rad"][1:159]).all()
    both = rows["A.yaw_increment_rad"][1:159:2] + rows["A.yaw_increment_rad"][2:159:2]
    np.testing.assert_allclose(both, rows["truth.yaw_increment_rad"][1:159].reshape(-1, 2).sum(axis=1), atol=1e-6)


def test_quality_beside_a_trajectory_becomes_columns(tmp_path):
    folders = write_set(tmp_path, {"A": 0.0, "B": 0.0}, sequences=2)
    state = ["tracking"] * 160
    state[40:60] = ["lost"] * 20
    lines = [f"{100 + k},{state[k]},0.5,0.002" for k in range(160)]
    quality = folders["A"] / "drive00.quality.csv"
    quality.write_text("\n".join(["matches,state,confidence,yaw_std_rad", *lines]) + "\n")
    recordings = made(folders)
    rows = recordings.rows(0)
    assert recordings.manifest.counted == ("A",)
    assert recordings.counting == ("A", "B")
    assert (rows["A.state"][40:60] == State.LOST).all()
    assert np.isnan(rows["A.yaw_increment_rad"][40:60]).all()
    np.testing.assert_array_equal(rows["A.matches"][1:40], np.arange(101, 140))
    np.testing.assert_allclose(rows["A.yaw_std_rad"][1:40], 0.002, rtol=1e-5)
    np.testing.assert_allclose(rows["A.confidence"][1:40], 0.5)
    assert np.isnan(recordings.rows(1)["A.matches"]).all()
    for bad, message in (
        ("matches,feeling", "unknown column 'feeling'"),
        ("matches,matches", "every column once"),
        ("matches,state", "expected 160 lines, one per pose, got 0"),
    ):
        quality.write_text(bad + "\n")
        with pytest.raises(TrajectoryError, match=message):
            made(folders)
    quality.write_text("\n".join(["matches", *["-1"] * 160]))
    with pytest.raises(TrajectoryError, match="line 2: expected matches of 0 or more, got '-1'"):
        made(folders)


@pytest.mark.parametrize(("axes", "likely"), [("camera", "camera"), ("ned", "ned"), ("opengl", "opengl")])
def test_wrong_axes_are_refused_with_the_likely_ones(tmp_path, axes, likely):
    folders = write_set(tmp_path, {"A": 0.0, "B": 1e-3}, sequences=2, form="tum")
    for sequence in range(2):
        write_tum(folders["A"] / f"drive{sequence:02d}.txt", in_axes(drive(sequence), axes))
    with pytest.raises(TrajectoryError, match=f"A, all sequences: its yaw is .* --axes A={likely} fits"):
        made(folders, reading=Reading())
    right = made(folders, reading=Reading(axes={"A": axes}))
    np.testing.assert_allclose(right.rows(0)["A.yaw_increment_rad"][1:], expected(0), atol=1e-6)
    assert made(folders, reading=Reading(), despite=("A",)).experts == ("A", "B")


def test_one_sequence_with_other_axes_is_refused(tmp_path):
    folders = write_set(tmp_path, {"A": 0.0}, sequences=4, form="tum")
    write_tum(folders["A"] / "drive02.txt", in_axes(drive(2), "ned"))
    with pytest.raises(TrajectoryError, match=r"A, drive02: its yaw is -1.00 times"):
        made(folders, reading=Reading())


def test_a_truth_with_wrong_axes_is_the_one_that_is_named(tmp_path):
    folders = write_set(tmp_path, {"A": 1e-3, "B": 1e-3}, sequences=2, form="tum")
    for sequence in range(2):
        write_tum(folders["groundtruth"] / f"drive{sequence:02d}.txt", in_axes(drive(sequence), "camera"))
    with pytest.raises(TrajectoryError, match=r"ground truth: its yaw .* --axes groundtruth=camera fits"):
        made(folders, reading=Reading())
    assert made(folders, reading=Reading(axes={"groundtruth": "camera"})).experts == ("A", "B")


def test_yaw_of_another_scale_is_refused(tmp_path):
    folders = write_set(tmp_path, {"A": 0.0}, sequences=2, form="tum")
    for sequence in range(2):
        way = drive(sequence)
        _, _, yaw = way.planar()
        write_tum(
            folders["A"] / f"drive{sequence:02d}.txt", way.from_planar(0 * yaw, 0 * yaw, 2 * yaw, way.timestamps_s)
        )
    with pytest.raises(TrajectoryError, match=r"its yaw is 2.00 times .* no axes fit"):
        made(folders, reading=Reading())


def test_bad_experts_and_straight_roads_are_not_refused(tmp_path):
    folders = write_set(tmp_path, {"NOISE": 0.5, "STUCK": 0.0}, sequences=2, form="tum")
    for path in folders["STUCK"].glob("*.txt"):
        values = read_numbers(path).values
        values[:, 4:] = [0.0, 0.0, 0.0, 1.0]
        np.savetxt(path, values, fmt="%.9f")
    assert made(folders, reading=Reading()).experts == ("NOISE", "STUCK")
    straight = write_set(tmp_path / "straight", {"A": 0.0}, sequences=1, form="tum")
    for axes, name in (("vehicle", "groundtruth"), ("ned", "A")):
        way = drive(0)
        line = way.from_planar(0.8 * np.arange(160), np.zeros(160), np.zeros(160), way.timestamps_s)
        write_tum(straight[name] / "drive00.txt", in_axes(line, axes))
    assert made(straight, reading=Reading()).experts == ("A",)


def test_logs_and_folds(tmp_path):
    rules = {"MH_*": "hall"}
    assert [log_of(name, rules) for name in ("MH_01", "V1_part2", "V1_part3", "03", "city-clip07", "clip1")] == [
        *("hall", "V1", "V1", "03", "city", "clip1")
    ]
    folders = write_set(tmp_path, {"A": 0.0}, sequences=6)
    recordings = made(folders)
    assert sorted(scene.fold for scene in recordings.scenes) == [0, 0, 1, 1, 2, 3]
    out = made(folders, leave_one_out=True)
    assert [scene.fold for scene in out.scenes] == [0, 1, 2, 3, 4, 5]
    assert len(out.select(split="train")) == 5
    joined = made(folders, leave_one_out=True, logs={"drive0[0-3]": "east"})
    assert [(scene.log, scene.fold) for scene in joined.scenes][3:5] == [("east", 2), ("drive04", 0)]
    with pytest.raises(ConfigurationError, match="no sequence is called so"):
        made(folders, logs={"x*": "y"})


def test_distance_from_wheels_an_expert_or_the_truth(tmp_path):
    folders = write_set(tmp_path, {"A": 0.0}, sequences=2)
    truth = made(folders)
    own = made(folders, distance="A")
    assert (truth.manifest.distance, own.manifest.distance) == ("truth", "A")
    assert truth.manifest.parameters["import"]["distance_privileged"] is True
    np.testing.assert_allclose(own["distance_m"], truth["distance_m"], rtol=1e-4)
    wheels = tmp_path / "wheels"
    wheels.mkdir()
    for sequence in range(2):
        lines = [f"{k / 50} 8.4" for k in range(-5, 900)]
        (wheels / f"drive{sequence:02d}.txt").write_text("\n".join(lines))
    recordings = made(folders, distance=str(wheels))
    assert recordings.manifest.distance == "wheels"
    np.testing.assert_allclose(recordings.rows(1)["distance_m"][1:], 0.84, rtol=1e-5)
    np.testing.assert_allclose(recordings.rows(1)["speed_mps"], 8.4, rtol=1e-4)
    with pytest.raises(ConfigurationError, match="--distance nowhere: expected truth, one of the experts A"):
        made(folders, distance="nowhere")
    (wheels / "drive01.txt").write_text("1 2 3\n4 5 6\n")
    with pytest.raises(TrajectoryError, match="expected `time speed` a line"):
        made(folders, distance=str(wheels))


def test_the_constant_rate_goes_on_as_the_others_did():
    increments = np.array([[np.nan, 0.1, 0.2, np.nan, np.nan], [np.nan, 0.3, 0.2, np.nan, 0.1]])
    columns = constant_rate_columns(increments, np.array([0.0, 1.0, 2.0, 1.0, 1.0]))
    np.testing.assert_allclose(columns["yaw_increment_rad"], [np.nan, np.nan, 0.4, 0.1, 0.1], rtol=1e-6)
    assert columns["state"].tolist() == [State.LOST, State.LOST, *[State.TRACKING] * 3]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("import", "--expert", "A=x"), "expected --groundtruth FOLDER, or the recording to be extended"),
        (("import", "mixocity", "--groundtruth", "g", "--expert", "A=x"), "--groundtruth makes a new recording"),
        (("import", "mixocity", "--expert", "A=x", "--rate", "10"), "--rate is for new recordings"),
        (("import", "mixocity", "--expert", "A=x", "--leave-one-out"), "--leave-one-out is for new recordings"),
        (("import", "--groundtruth", "g", "--expert", "A"), "expected --expert NAME=FOLDER, got 'A'"),
        (("import", "--groundtruth", "g", "--expert", "A=x", "A=y"), "--expert A is given twice"),
        (("import", "--groundtruth", "g", "--expert", "A=x", "--without", "B"), "--without is for recordings"),
        (("import", "--groundtruth", "g", "--expert", "A=x", "--rate", "1", "--times", "t"), "give one of them"),
        (("import", "--groundtruth", "g", "--expert", "A=x", "--axes", "A=up"), "unknown axes 'up'"),
        (("import", "--groundtruth", "g", "--expert", "A=x", "--axes", "B=ned"), "unknown expert of --axes 'B'"),
        (("import", "--groundtruth", "g"), "expected at least one --expert"),
        (("import", "--groundtruth", "g", "--expert", "truth=x"), "'truth' is the name of something else"),
        (("import", "--groundtruth", "g", "--expert", "LINEAR=x"), "'LINEAR' is the name of something else"),
        (("import", "--groundtruth", "g", "--expert", "../x=x"), "expected a name of letters"),
    ],
)
def test_contradictions_are_one_line(tmp_path, capsys, arguments, message):
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1


def test_files_without_times_need_them_once(tmp_path):
    folders = write_set(tmp_path, {"A": 0.0}, sequences=1)
    with pytest.raises(TrajectoryError, match="expected a time for each pose, got none: give --times FOLDER or --rate"):
        made(folders, reading=Reading())
    with pytest.raises(TrajectoryError, match=r"expected the times of drive00 in drive00.txt"):
        made(folders, reading=Reading(times=tmp_path))


def test_rules_that_cannot_hold_are_refused(tmp_path):
    folders = write_set(tmp_path, {"A": 0.0}, sequences=1)
    with pytest.raises(ConfigurationError, match="expected at least one expert"):
        made({"groundtruth": folders["groundtruth"]})
    with pytest.raises(ConfigurationError, match="'B' is none of the experts A"):
        made(folders, despite=("B",))
    for gap in (0.0, -1.0, float("nan")):
        with pytest.raises(ConfigurationError, match="expected --max-gap-s above 0"):
            made(folders, maximum_gap_s=gap)
    for rate in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ConfigurationError, match="expected --rate in poses a second"):
            Reading(rate_hz=rate)


@pytest.mark.parametrize(
    ("lines", "complaint"),
    [
        (["0 1", "1 1", "1 1"], "line 3: expected increasing times"),
        (["0 1", "1 200", "2 1"], "line 2: expected a speed in m/s, got 200"),
        (["1 2 3"], "expected `time speed` a line"),
        (["5000 1", "5001 1"], "tells no distance"),
    ],
    ids=["back in time", "flying", "columns", "another day"],
)
def test_wheels_without_sense_are_one_line(tmp_path, lines, complaint):
    folders = write_set(tmp_path, {"A": 0.0}, sequences=1)
    (tmp_path / "wheels").mkdir()
    (tmp_path / "wheels" / "drive00.txt").write_text("\n".join(lines) + "\n")
    with pytest.raises(TrajectoryError, match=complaint):
        made(folders, distance=str(tmp_path / "wheels"))


def test_wheels_of_one_speed_a_pose_and_a_missing_file(tmp_path):
    folders = write_set(tmp_path, {"A": 0.0}, sequences=2)
    (tmp_path / "wheels").mkdir()
    poses = len(read_numbers(next(iter(sorted(folders["groundtruth"].iterdir())))).values)
    (tmp_path / "wheels" / "drive00.txt").write_text("8.4\n" * poses)
    with pytest.raises(TrajectoryError, match="no wheel speeds for drive01"):
        made(folders, distance=str(tmp_path / "wheels"))
    (tmp_path / "wheels" / "drive01.txt").write_text("8.4\n" * poses)
    recordings = made(folders, distance=str(tmp_path / "wheels"))
    np.testing.assert_allclose(recordings.rows(0)["distance_m"][1:], 8.4 / RATE_HZ, rtol=1e-5)


@pytest.mark.parametrize(
    ("lines", "complaint"),
    [
        (["0 0"] * 400, "expected one time in seconds a line, got 2 columns"),
        (["0", "1", "2"], "expected a time for each of the"),
        ([f"{k}" for k in (0, 2, 1, *range(3, 2000))], "line 3: expected increasing times"),
    ],
    ids=["columns", "too few", "back in time"],
)
def test_times_without_sense_are_one_line(tmp_path, lines, complaint):
    folders = write_set(tmp_path, {"A": 0.0}, sequences=1)
    times = tmp_path / "times.txt"
    times.write_text("\n".join(lines) + "\n")
    with pytest.raises(TrajectoryError, match=complaint):
        made(folders, reading=Reading(times=times))


def test_an_expert_that_has_no_file_of_a_sequence_gives_it_no_distance(tmp_path):
    folders = write_set(tmp_path, {"A": 0.0, "B": 0.0}, sequences=2)
    (folders["A"] / "drive01.txt").unlink()
    with pytest.raises(TrajectoryError, match="drive01: A tells no distance"):
        made(folders, distance="A")
