"""Formats people have: one drive written in each of them is read as the same drive."""

from __future__ import annotations

import gzip
import os
from pathlib import Path

import numpy as np
import pytest

from mixo_env.errors import TrajectoryError
from mixo_env.geometry import angle_between_quaternions_rad
from mixo_env.metrics.association import match
from mixo_env.trajectory import Trajectory, read_trajectory
from mixo_env.trajectory.formats import TrajectoryFiles
from tests.trajectories import drive

# Whole milliseconds: seconds and nanoseconds then are the same times.
BASE = drive(np.random.default_rng(3), 80)
TIMES = np.array([round(1.7e9 + 0.1 * k, 3) for k in range(80)])
DRIVE = Trajectory(BASE.positions_m, BASE.quaternions_wxyz, TIMES)
SECONDS = [f"{t:.3f}" for t in 1.7e9 + 0.1 * np.arange(80)]
NANO = [str(1_700_000_000_000_000_000 + 100_000_000 * k) for k in range(80)]
FRAMES = [str(k) for k in range(80)]
P, Q = DRIVE.positions_m.tolist(), DRIVE.quaternions_wxyz.tolist()
M = DRIVE.matrices().reshape(-1, 16).tolist()


def text(first: list[str], *parts: list[list[float]], separator: str = " ", end: str = "") -> str:
    rows = zip(first, *parts, strict=True)
    return "".join(
        separator.join([*([row[0]] if row[0] else []), *(repr(x) for part in row[1:] for x in part)]) + end + "\n"
        for row in rows
    )


XYZW = [[*q[1:], q[0]] for q in Q]
NOTHING = [""] * 80
ZEROS = [[0.0] * 9] * 80
VELOCITY = [[1.0, 0.5, -0.25]] * 80
LAST = [[0.0, 0.0, 0.0, 1.0]] * 80
K34 = [m[:12] for m in M]
TUM = text(SECONDS, P, XYZW)
EUROC_NAMES = "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"

QUATERNION_FILES = {
    "TUM": TUM,
    "TUM with commas": text(SECONDS, P, XYZW, separator=","),
    "TUM with semicolons": text(SECONDS, P, XYZW, separator=";"),
    "TUM with comma and blank": text(SECONDS, P, XYZW, separator=", "),
    "TUM with tabs and a tab at the end": text(SECONDS, P, XYZW, separator="\t", end="\t"),
    "TUM with a heading": "timestamp tx ty tz qx qy qz qw\n" + TUM,
    "TUM with a heading behind %": "% timestamp tx ty tz qx qy qz qw\n" + TUM,
    "TUM w first by heading": "t,x,y,z,qw,qx,qy,qz\n" + text(SECONDS, P, Q, separator=","),
    "TUM in quotes": "".join(f'"{line}"\n' for line in text(SECONDS, P, XYZW, separator='","').splitlines()),
    "TUM with comments in between": TUM.replace("\n", "\n# here\n\n", 3).replace("\n", " # seen\n", 5),
    "old Macintosh line ends": TUM.replace("\n", "\r"),
    "byte-order mark and Windows line ends": "\ufeff" + TUM.replace("\n", "\r\n"),
    "nanoseconds in TUM order (ORB-SLAM3)": text([f"{ns}.000000" for ns in NANO], P, XYZW),
    "nanoseconds in TUM order, commas and heading (VSLAM-LAB)": "ts (ns),tx (m),ty (m),tz (m),qx,qy,qz,qw\n"
    + text(NANO, P, XYZW, separator=","),
    "nanoseconds in TUM order, commas alone": text(NANO, P, XYZW, separator=","),
    "EuRoC without states": EUROC_NAMES + "\n" + text(NANO, P, Q, separator=","),
    "EuRoC without heading": text(NANO, P, Q, separator=","),
    "EuRoC with states": text(NANO, P, Q, ZEROS, separator=","),
    "EuRoC with states and a bare heading": "time,a,b\n" + text(NANO, P, Q, ZEROS, separator=","),
    "TUM with states, seconds": text(SECONDS, P, XYZW, ZEROS),
    "EuRoC with states, seconds": text(SECONDS, P, Q, ZEROS, separator=","),
    "TUM with a comma at the end": text(SECONDS, P, XYZW, separator=",", end=","),
    "TUM with row numbers (pandas)": ",t,x,y,z,qx,qy,qz,qw\n"
    + "".join(f"{k},{line}\n" for k, line in enumerate(text(SECONDS, P, XYZW, separator=",").splitlines())),
    "VINS-Fusion": text(NANO, P, Q, VELOCITY, separator=",", end=","),
    "VINS-Mono": text(NANO, P, Q, VELOCITY, separator=","),
    "VINS with blanks": text(NANO, P, Q, VELOCITY),
    "VINS-Fusion's loop closure": text(NANO, P, Q, separator=",", end=","),
}

MATRIX_FILES = {
    "KITTI": text(NOTHING, K34),
    "KITTI with commas": text(NOTHING, K34, separator=","),
    "4x4": text(NOTHING, K34, LAST),
    "KITTI with times": text(SECONDS, K34),
    "KITTI with nanoseconds": text(NANO, K34),
    "4x4 with times": text(SECONDS, K34, LAST),
    "KITTI with frames": text(FRAMES, K34),
    "4x4 with frames": text(FRAMES, K34, LAST),
}


def same_drive(trajectory: Trajectory) -> None:
    np.testing.assert_allclose(trajectory.positions_m, DRIVE.positions_m, atol=1e-9)
    assert angle_between_quaternions_rad(trajectory.quaternions_wxyz, DRIVE.quaternions_wxyz).max() < 1e-7


@pytest.mark.parametrize("suffix", [".txt", ".csv"])
@pytest.mark.parametrize("name", QUATERNION_FILES)
def test_a_format_is_told_from_what_the_file_holds(tmp_path, name, suffix):
    path = tmp_path / f"a{suffix}"
    path.write_bytes(QUATERNION_FILES[name].encode())
    trajectory = read_trajectory(path)
    same_drive(trajectory)
    assert trajectory.timestamps_s is not None
    np.testing.assert_allclose(trajectory.timestamps_s, TIMES, atol=1e-6)
    assert not trajectory.camera_axes


@pytest.mark.parametrize("name", MATRIX_FILES)
def test_matrices_are_read_with_and_without_first_column(tmp_path, name):
    path = tmp_path / "a.txt"
    path.write_text(MATRIX_FILES[name])
    trajectory = read_trajectory(path)
    same_drive(trajectory)
    assert trajectory.camera_axes
    if "times" in name or "nano" in name:
        np.testing.assert_allclose(np.asarray(trajectory.timestamps_s), TIMES, atol=1e-6)
    assert trajectory.counted == ("frames" in name)


@pytest.mark.filterwarnings("error")
def test_rotations_with_tiny_numbers_are_no_warning(tmp_path):
    rows = "0 1 0 0 1e-320 1 0 0 0 0 1 0\n1 0 0 0 1e-320 1 0 0 0 0 1 0\n"
    (tmp_path / "a.txt").write_text(rows)
    with pytest.raises(TrajectoryError, match="line 1: expected a rotation"):
        read_trajectory(tmp_path / "a.txt")


def test_a_packed_file_is_unpacked(tmp_path):
    (tmp_path / "a.txt.gz").write_bytes(gzip.compress(TUM.encode()))
    same_drive(read_trajectory(tmp_path / "a.txt.gz"))


def test_what_was_assumed_is_noted_once_a_file_leaves_it_open(tmp_path):
    notes = {}
    told = ("TUM", "EuRoC without states", "VINS-Mono")
    for name in (*told, "EuRoC without heading", "nanoseconds in TUM order (ORB-SLAM3)"):
        path = tmp_path / f"{name}.txt"
        path.write_text(QUATERNION_FILES[name])
        files = TrajectoryFiles()
        files.read(path)
        notes[name] = files.notes.get(path, "")
    assert notes == {
        "TUM": "",
        "EuRoC without states": "",
        "VINS-Mono": "",
        "EuRoC without heading": "quaternions read as w x y z, which fits the motion",
        "nanoseconds in TUM order (ORB-SLAM3)": "nanoseconds, quaternions read as x y z w",
    }


def test_times_from_a_pipe_serve_both_sides(tmp_path):
    (tmp_path / "gt.txt").write_text(MATRIX_FILES["KITTI"])
    (tmp_path / "est.txt").write_text(MATRIX_FILES["KITTI with frames"])
    read, write = os.pipe()
    os.write(write, "".join(f"{t}\n" for t in SECONDS).encode())
    os.close(write)
    files = TrajectoryFiles(Path(f"/dev/fd/{read}"))
    both = [files.read(tmp_path / name).timestamps_s for name in ("gt.txt", "est.txt")]
    os.close(read)
    np.testing.assert_array_equal(np.asarray(both[0]), TIMES)
    np.testing.assert_array_equal(np.asarray(both[1]), TIMES)


def test_the_option_decides_what_neither_heading_nor_motion_tells(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("".join(f"{ns},{k},0,0,0.6,0,0,0.8\n" for k, ns in enumerate(NANO)))
    with pytest.raises(TrajectoryError, match="--quaternions wxyz or xyzw"):
        read_trajectory(path)
    np.testing.assert_allclose(read_trajectory(path, quaternions="wxyz").quaternions_wxyz[0], [0.6, 0, 0, 0.8])
    np.testing.assert_allclose(read_trajectory(path, quaternions="xyzw").quaternions_wxyz[0], [0.8, 0.6, 0, 0])
    path.write_text("t x y z qw qx qy qz\n" + path.read_text())
    np.testing.assert_allclose(read_trajectory(path, quaternions="xyzw").quaternions_wxyz[0], [0.6, 0, 0, 0.8])


@pytest.mark.parametrize(("start", "first"), [("1,0,0,0", [1, 0, 0, 0]), ("0,0,0,1", [1, 0, 0, 0])])
def test_a_path_that_begins_at_the_identity_tells_the_order(tmp_path, start, first):
    path = tmp_path / "a.csv"
    path.write_text("".join(f"{ns},{k},0,0,{start}\n" for k, ns in enumerate(NANO)))
    np.testing.assert_array_equal(read_trajectory(path).quaternions_wxyz[0], first)


@pytest.mark.parametrize("kept", [slice(None), slice(0, None, 7), slice(20, 50, 3)], ids=["all", "sparse", "part"])
def test_frame_numbers_point_into_the_truth(tmp_path, kept):
    (tmp_path / "gt.txt").write_text(MATRIX_FILES["KITTI"])
    (tmp_path / "est.txt").write_text("".join(MATRIX_FILES["KITTI with frames"].splitlines(keepends=True)[kept]))
    truth, estimate = match(read_trajectory(tmp_path / "gt.txt"), read_trajectory(tmp_path / "est.txt"))
    np.testing.assert_array_equal(truth.positions_m, DRIVE.positions_m[kept])
    np.testing.assert_array_equal(estimate.positions_m, DRIVE.positions_m[kept])
    truth, estimate = match(read_trajectory(tmp_path / "est.txt"), read_trajectory(tmp_path / "gt.txt"))
    np.testing.assert_array_equal(estimate.positions_m, DRIVE.positions_m[kept])


def test_frame_numbers_point_into_the_times(tmp_path):
    (tmp_path / "times.txt").write_text("".join(f"{t}\n" for t in SECONDS))
    (tmp_path / "est.txt").write_text("".join(MATRIX_FILES["4x4 with frames"].splitlines(keepends=True)[10::4]))
    times = read_trajectory(tmp_path / "est.txt", tmp_path / "times.txt").timestamps_s
    np.testing.assert_array_equal(np.asarray(times), TIMES[10::4])


def test_a_long_table_is_read(tmp_path):
    path: Path = tmp_path / "long.txt"
    count = 100_000
    path.write_text("".join(f"{0.01 * k:.2f} {0.1 * k:.1f} 0 0 0 0 0 1\n" for k in range(count)))
    assert len(read_trajectory(path)) == count
