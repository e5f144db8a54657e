"""Reading and writing trajectory files: round trips, accepted variants, and errors that name file and line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mixo_env.errors import ConfigurationError, TrajectoryError
from mixo_env.geometry import angle_between_quaternions_rad, rotation_from_quaternion_wxyz
from mixo_env.trajectory import Trajectory, read_trajectory, write_kitti, write_tum
from mixo_env.trajectory.layout import RPG_ESTIMATE, RPG_TRUTH, pair_scenes, scene_files
from tests.trajectories import drive

TUM = "0.0 1 2 3 0 0 0 1\n0.1 2 2 3 0 0 0 1\n0.2 3 2 3 0 0 0.6 0.8\n"
KITTI = "1 0 0 5 0 1 0 6 0 0 1 7\n1 0 0 5 0 1 0 6 0 0 1 8\n"
EUROC = (
    "#timestamp, p_x, p_y, p_z, q_w, q_x, q_y, q_z\n"
    "1403636579763555584,1,2,3,0.8,0,0,0.6\n1403636579813555456,2,2,3,1,0,0,0\n"
)


def write(path: Path, text: str) -> Path:
    path.write_bytes(text.encode())
    return path


def test_tum_round_trip_keeps_every_bit(tmp_path):
    trajectory = drive(np.random.default_rng(0))
    write_tum(tmp_path / "a.txt", trajectory)
    again = read_trajectory(tmp_path / "a.txt")
    np.testing.assert_array_equal(again.timestamps_s, trajectory.timestamps_s)
    np.testing.assert_array_equal(again.positions_m, trajectory.positions_m)
    np.testing.assert_allclose(again.quaternions_wxyz, trajectory.quaternions_wxyz, atol=1e-15)
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]


def test_kitti_round_trip_keeps_poses_up_to_rounding(tmp_path):
    trajectory = drive(np.random.default_rng(1))
    write_kitti(tmp_path / "a.txt", trajectory)
    again = read_trajectory(tmp_path / "a.txt")
    assert again.timestamps_s is None
    assert again.camera_axes
    np.testing.assert_array_equal(again.positions_m, trajectory.positions_m)
    assert angle_between_quaternions_rad(again.quaternions_wxyz, trajectory.quaternions_wxyz).max() < 1e-14


def test_columns_mean_what_the_formats_say(tmp_path):
    tum = read_trajectory(write(tmp_path / "a.txt", TUM))
    np.testing.assert_allclose(tum.quaternions_wxyz[2], [0.8, 0, 0, 0.6])
    np.testing.assert_allclose(tum.timestamps_s, [0, 0.1, 0.2])
    euroc = read_trajectory(write(tmp_path / "data.csv", EUROC))
    np.testing.assert_allclose(euroc.quaternions_wxyz[0], [0.8, 0, 0, 0.6])
    assert euroc.timestamps_s[1] - euroc.timestamps_s[0] == pytest.approx(0.05, abs=1e-6)
    kitti = read_trajectory(write(tmp_path / "b.txt", KITTI))
    np.testing.assert_allclose(kitti.positions_m, [[5, 6, 7], [5, 6, 8]])
    timed = "".join(f"{k} {line}\n" for k, line in enumerate(KITTI.splitlines()))
    np.testing.assert_allclose(read_trajectory(write(tmp_path / "c.txt", timed)).timestamps_s, [0, 1])
    times = write(tmp_path / "times.txt", "0.5\n0.6\n")
    np.testing.assert_allclose(read_trajectory(tmp_path / "b.txt", times).timestamps_s, [0.5, 0.6])


@pytest.mark.parametrize(
    "text",
    [
        TUM.replace("\n", "\r\n"),
        "\ufeff" + TUM,
        "# header\n\n" + TUM + "\n\n",
        TUM.replace(" ", "\t"),
        TUM.replace("0.6 0.8", "0.60003 0.79998"),
        TUM.rstrip("\n"),
    ],
    ids=["windows", "byte-order mark", "comments", "tabs", "rounded quaternion", "no last line end"],
)
def test_variants_are_read(tmp_path, text):
    trajectory = read_trajectory(write(tmp_path / "a.txt", text))
    assert len(trajectory) == 3
    np.testing.assert_allclose(np.linalg.norm(trajectory.quaternions_wxyz, axis=1), 1.0)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "the file is empty"),
        ("# only a comment\n", "the file is empty"),
        (TUM.splitlines()[0], "line 1: expected at least 2 poses"),
        (TUM.replace("2 2 3", "2 nan 3"), "line 2: expected finite numbers"),
        (TUM.replace("2 2 3", "2 inf 3"), "line 2: expected finite numbers"),
        ("# c\n" + TUM.replace("0.6 0.8", "0.6 0.9"), r"line 4: expected a quaternion of length 1, got 1\.08"),
        (TUM.replace("0 0 0 1\n0.1", "0 0 0 0\n0.1"), "line 1: expected a quaternion of length 1, got 0"),
        (TUM.replace("2 2 3", "2 2"), "line 2: expected 8 columns as in line 1, got 7"),
        (TUM.replace("2 2 3", "2 2 3 4"), "line 2: expected 8 columns as in line 1, got 9"),
        ("1 2 3\n4 5 6\n", "line 1: expected 8 columns .* got 3"),
        (TUM.replace("2 2 3", "2 zwei 3"), "line 2: expected numbers, got 'zwei'"),
        ("t x y z qx qy qz 1\n" + TUM, "line 1: expected numbers, got 't'"),
        (TUM.replace("0.2 ", "0.1 "), "line 3: expected increasing times"),
        (TUM.replace("0.2 ", "0.05 "), "line 3: expected increasing times"),
        (KITTI.replace("1 0 0 5", "2 0 0 5"), "line 1: expected a rotation"),
        (KITTI.replace("0 0 1 8", "0 0 -1 8"), "line 2: expected a rotation"),
    ],
)
def test_errors_name_file_and_line(tmp_path, text, words):
    path = write(tmp_path / "some file.txt", text)
    with pytest.raises(TrajectoryError, match=f"some file.txt.*{words}") as caught:
        read_trajectory(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "milliseconds"), (1e6, "microseconds")])
def test_stamps_in_another_unit_are_recognised(tmp_path, factor, unit):
    lines = [f"{int((1.7e9 + 0.1 * k) * factor)} {k} 0 0 0 0 0 1\n" for k in range(3)]
    with pytest.raises(TrajectoryError, match=f"line 1: expected a time in seconds.*{unit}: divide"):
        read_trajectory(write(tmp_path / "a.txt", "".join(lines)))


def test_unreadable_files_get_one_line(tmp_path):
    with pytest.raises(TrajectoryError, match=r"none\.txt: .*No such file"):
        read_trajectory(tmp_path / "none.txt")
    (tmp_path / "binary.txt").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(TrajectoryError, match="not a text file"):
        read_trajectory(tmp_path / "binary.txt")


def test_times_must_fit_the_poses(tmp_path):
    kitti = write(tmp_path / "k.txt", KITTI)
    with pytest.raises(TrajectoryError, match=r"expected 2 times, one per pose .*, got 3"):
        read_trajectory(kitti, write(tmp_path / "t.txt", "0\n1\n2\n"))
    with pytest.raises(TrajectoryError, match="one time in seconds a line"):
        read_trajectory(kitti, write(tmp_path / "t.txt", "0 1\n1 1\n"))
    with pytest.raises(ConfigurationError, match="holds its own times"):
        read_trajectory(write(tmp_path / "a.txt", TUM), tmp_path / "t.txt")


def test_a_tum_file_needs_times(tmp_path):
    with pytest.raises(TrajectoryError, match="needs a time"):
        write_tum(tmp_path / "a.txt", Trajectory(np.zeros((2, 3)), np.tile([1.0, 0, 0, 0], (2, 1))))


def test_rounded_rotations_become_the_nearest_ones(tmp_path):
    trajectory = drive(np.random.default_rng(2))
    rows = trajectory.matrices()[:, :3, :].reshape(-1, 12).round(5)
    np.savetxt(tmp_path / "a.txt", rows, fmt="%.5f")
    rotation = rotation_from_quaternion_wxyz(read_trajectory(tmp_path / "a.txt").quaternions_wxyz)
    u, _, vt = np.linalg.svd(rows.reshape(-1, 3, 4)[:, :, :3])
    np.testing.assert_allclose(rotation, u @ vt, atol=1e-12)


def test_shapes_are_checked():
    with pytest.raises(TrajectoryError, match="one row per pose"):
        Trajectory(np.zeros((3, 2)), np.zeros((3, 4)))
    with pytest.raises(TrajectoryError, match="timestamps"):
        Trajectory(np.zeros((3, 3)), np.zeros((3, 4)), np.zeros(2))


def test_planar_view_of_both_axes_conventions():
    yaw = np.linspace(-3.0, 4.0, 20)
    x, y = np.cos(yaw), 2 * np.sin(yaw)
    vehicle = Trajectory.from_planar(x, y, yaw)
    np.testing.assert_allclose(vehicle.planar(), [x, y, yaw], atol=1e-12)
    camera_from_vehicle = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])
    matrices = camera_from_vehicle @ vehicle.matrices() @ camera_from_vehicle.T
    np.testing.assert_allclose(Trajectory.from_matrices(matrices, camera_axes=True).planar(), [x, y, yaw], atol=1e-12)


def test_folders_of_scenes_and_the_rpg_layout(tmp_path):
    for folder in ("gt", "est"):
        (tmp_path / folder).mkdir()
        for scene in ("scene-1", "scene-2"):
            write(tmp_path / folder / f"{scene}.txt", TUM)
    write(tmp_path / "gt" / "times.txt", "0\n")
    assert list(pair_scenes(tmp_path / "gt", tmp_path / "est")) == ["scene-1", "scene-2"]
    for dataset in ("laptop_vio_a", "laptop_vio_b"):
        (tmp_path / "rpg" / dataset).mkdir(parents=True)
        for name in (RPG_TRUTH, RPG_ESTIMATE):
            write(tmp_path / "rpg" / dataset / name, TUM)
    pairs = pair_scenes(tmp_path / "rpg", tmp_path / "rpg")
    assert list(pairs) == ["laptop_vio_a", "laptop_vio_b"]
    assert pairs["laptop_vio_a"][1].name == RPG_ESTIMATE
    assert list(scene_files(tmp_path / "rpg" / "laptop_vio_a", RPG_TRUTH)) == ["laptop_vio_a"]
    # One file on each side pairs whatever the names.
    one = pair_scenes(tmp_path / "gt" / "scene-1.txt", tmp_path / "est" / "scene-2.txt")
    assert list(one) == ["scene-1"]


def test_missing_scenes_are_an_error_on_either_side(tmp_path):
    for folder, scenes in (("gt", "abc"), ("est", "a"), ("more", "abcd")):
        (tmp_path / folder).mkdir()
        for scene in scenes:
            write(tmp_path / folder / f"{scene}.txt", TUM)
    with pytest.raises(TrajectoryError, match="est: expected the 3 scenes of the other side, 2 are missing: b, c"):
        pair_scenes(tmp_path / "gt", tmp_path / "est")
    with pytest.raises(TrajectoryError, match=r"gt: .* missing: d"):
        pair_scenes(tmp_path / "gt", tmp_path / "more")
    with pytest.raises(TrajectoryError, match="found nothing there"):
        pair_scenes(tmp_path / "gt", tmp_path / "none")
    (tmp_path / "empty").mkdir()
    with pytest.raises(TrajectoryError, match="found none"):
        pair_scenes(tmp_path / "gt", tmp_path / "empty")
    write(tmp_path / "gt" / "a.csv", EUROC)
    with pytest.raises(TrajectoryError, match="share a name"):
        pair_scenes(tmp_path / "gt", tmp_path / "est")
