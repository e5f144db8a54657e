"""Open a simulated folder with the official nuscenes-devkit, as a stranger would.

The devkit lives in a virtual environment of its own (it asks for an older NumPy); this script imports nothing else:

    python3 -m venv devkit && devkit/bin/pip install nuscenes-devkit==1.2.0
    devkit/bin/python experiments/check_devkit.py FOLDER

It walks every sample and every sweep, checks each image, projects known points into every camera and reads the CAN
bus. Exit code 0: all good; 1: a line for everything found wrong.
"""

# pyright: reportMissingImports=false
from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from nuscenes.can_bus.can_bus_api import NuScenesCanBus
from nuscenes.nuscenes import NuScenes
from nuscenes.utils.geometry_utils import view_points
from PIL import Image
from pyquaternion import Quaternion

# Direction of the optical axis in the ego frame, anticlockwise from straight ahead [deg]; NUSCENES calibration.
CAMERA_YAW_DEG = {
    "CAM_FRONT": 0.3,
    "CAM_FRONT_LEFT": 55.2,
    "CAM_FRONT_RIGHT": -56.4,
    "CAM_BACK_LEFT": 108.6,
    "CAM_BACK_RIGHT": -110.8,
    "CAM_BACK": 179.9,
}
MESSAGES = ("ms_imu", "pose", "zoe_veh_info", "vehicle_monitor", "steeranglefeedback")


class Findings(list):
    """Lines about what is wrong."""

    def expect(self, good: bool, line: str) -> None:
        """Note ``line`` unless ``good``."""
        if not good:
            self.append(line)


def walk_samples(nusc: NuScenes, scene: dict, found: Findings) -> list[dict]:
    """All key frames of a scene, following the chain."""
    samples, token = [], scene["first_sample_token"]
    while token:
        sample = nusc.get("sample", token)
        found.expect(not samples or sample["prev"] == samples[-1]["token"], f"{scene['name']}: broken sample chain")
        samples.append(sample)
        token = sample["next"]
    times = np.array([sample["timestamp"] for sample in samples])
    found.expect(len(samples) == scene["nbr_samples"], f"{scene['name']}: {len(samples)} samples")
    found.expect(samples[-1]["token"] == scene["last_sample_token"], f"{scene['name']}: wrong last sample")
    found.expect(bool(np.all(np.diff(times) > 0)), f"{scene['name']}: sample times do not increase")
    return samples


def walk_sweeps(nusc: NuScenes, name: str, sample: dict, images: bool, found: Findings) -> int:
    """Follow every camera's chain from the first key frame; returns the number of frames."""
    count = 0
    for channel, token in sample["data"].items():
        previous = None
        while token:
            frame = nusc.get("sample_data", token)
            pose = nusc.get("ego_pose", frame["ego_pose_token"])
            label = f"{name} {frame['filename']}"
            found.expect(frame["channel"] == channel, f"{label}: in the chain of {channel}")
            found.expect(pose["timestamp"] == frame["timestamp"], f"{label}: pose of another time")
            found.expect(abs(Quaternion(pose["rotation"]).norm - 1.0) < 1e-9, f"{label}: not a unit quaternion")
            folder = "samples" if frame["is_key_frame"] else "sweeps"
            found.expect(frame["filename"].startswith(f"{folder}/{channel}/"), f"{label}: in the wrong folder")
            if previous is not None:
                found.expect(frame["prev"] == previous["token"], f"{label}: broken chain")
                found.expect(frame["timestamp"] > previous["timestamp"], f"{label}: time does not increase")
            if images:
                with Image.open(Path(nusc.dataroot) / frame["filename"]) as image:
                    found.expect(image.size == (frame["width"], frame["height"]), f"{label}: {image.size} pixels")
            previous, token, count = frame, frame["next"], count + 1
    return count


def project(nusc: NuScenes, point_map: np.ndarray, token: str) -> tuple[float, float, float]:
    """Pixel and depth of a map point in one image, by the devkit's own means."""
    frame = nusc.get("sample_data", token)
    pose = nusc.get("ego_pose", frame["ego_pose_token"])
    sensor = nusc.get("calibrated_sensor", frame["calibrated_sensor_token"])
    point_ego = Quaternion(pose["rotation"]).inverse.rotate(point_map - np.array(pose["translation"]))
    point_camera = Quaternion(sensor["rotation"]).inverse.rotate(point_ego - np.array(sensor["translation"]))
    pixel = view_points(point_camera[:, None], np.array(sensor["camera_intrinsic"]), normalize=True)[:, 0]
    return float(pixel[0]), float(pixel[1]), float(point_camera[2])


def check_projection(nusc: NuScenes, name: str, sample: dict, found: Findings) -> None:
    """A point 20 m away in the direction of each camera, at its height, is seen near the middle of its image."""
    for channel, token in sample["data"].items():
        frame = nusc.get("sample_data", token)
        pose = nusc.get("ego_pose", frame["ego_pose_token"])
        w, x, y, z = pose["rotation"]
        yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        angle = yaw + np.radians(CAMERA_YAW_DEG[channel])
        point = np.array(pose["translation"]) + np.array([20.0 * np.cos(angle), 20.0 * np.sin(angle), 1.5])
        u, v, depth = project(nusc, point, token)
        # Mounting and lens differ by a degree or two from the nominal ones: a tenth of the image.
        near = (
            abs(u - 0.5 * frame["width"]) < 0.1 * frame["width"]
            and abs(v - 0.54 * frame["height"]) < 0.15 * frame["height"]
        )
        found.expect(
            near and 16.0 < depth < 22.0, f"{name} {channel}: point ahead seen at ({u:.0f}, {v:.0f}), {depth:.1f} m"
        )
        opposite = 2.0 * np.array(pose["translation"]) - point
        found.expect(project(nusc, opposite, token)[2] < 0.0, f"{name} {channel}: a point behind seems to be in front")
        left = point + np.array([-np.sin(angle), np.cos(angle), 0.0])
        found.expect(project(nusc, left, token)[0] < u, f"{name} {channel}: left and right are exchanged")


def check_can_bus(can: NuScenesCanBus, scene: dict, samples: list[dict], found: Findings) -> int:
    """Read every message; the gyro must agree with the poses in sign and size."""
    count, name = 0, scene["name"]
    for message in MESSAGES:
        rows = can.get_messages(name, message)
        times = np.array([row["utime"] for row in rows])
        found.expect(bool(np.all(np.diff(times) >= 0)), f"{name} {message}: times go back")
        reach_us = 1_600_000 if message == "vehicle_monitor" else 100_000  # 2 Hz, and one may be missing
        covered = times[0] - reach_us <= samples[0]["timestamp"] and times[-1] + reach_us >= samples[-1]["timestamp"]
        found.expect(bool(covered), f"{name} {message}: does not cover the scene")
        count += len(rows)
    poses, imu = can.get_messages(name, "pose"), can.get_messages(name, "ms_imu")
    times = np.array([row["utime"] for row in poses])
    yaw = np.unwrap([Quaternion(row["orientation"]).yaw_pitch_roll[0] for row in poses])
    rate_us = np.array([row["utime"] for row in imu])
    rate = np.array([row["rotation_rate"][2] for row in imu])
    turned = np.interp(rate_us[-1], times, yaw) - np.interp(rate_us[0], times, yaw)
    integral = float(np.sum(0.5 * (rate[1:] + rate[:-1]) * np.diff(rate_us)) / 1e6)
    found.expect(abs(turned - integral) < 0.1, f"{name}: poses turn by {turned:.3f} rad, the gyro by {integral:.3f}")
    return count


def main() -> int:
    """Check one folder."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--version", default="v1.0-mixo")
    arguments = parser.parse_args()
    nusc = NuScenes(version=arguments.version, dataroot=str(arguments.folder), verbose=False)
    can = NuScenesCanBus(dataroot=str(arguments.folder))
    found = Findings()
    images = (arguments.folder / "samples").exists()
    samples_seen = frames_seen = messages_seen = 0
    for scene in nusc.scene:
        samples = walk_samples(nusc, scene, found)
        samples_seen += len(samples)
        frames_seen += walk_sweeps(nusc, scene["name"], samples[0], images, found)
        for sample in samples:
            check_projection(nusc, scene["name"], sample, found)
        messages_seen += check_can_bus(can, scene, samples, found)
        log = nusc.get("log", scene["log_token"])
        found.expect(nusc.get("map", log["map_token"])["filename"].endswith(".png"), f"{scene['name']}: no map")
    for line in found:
        print(line)
    print(
        f"{len(nusc.scene)} scenes, {samples_seen} samples, {frames_seen} frames"
        f"{'' if images else ' (no images)'}, {messages_seen} CAN messages: {len(found)} findings"
    )
    return 1 if found or not frames_seen else 0


if __name__ == "__main__":
    sys.exit(main())
