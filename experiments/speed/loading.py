"""Opening a nuScenes folder: this package against the way the official devkit reads its tables.

Writes synthetic tables with the row counts of real scenes (3,095 sample_data and ego_pose rows a scene, 12 sensors, one
key per line as in the published files), then measures in a fresh process each: the devkit's way (standard JSON reader
into dictionaries, then indices from token to row and from sample to data), our first opening (builds the cache) and
our later ones, and `mixo inspect` of the same tables (there are no images and no CAN bus: every file is missed), the
first time with parsing. With ``--devkit`` the real devkit is timed as well, in its own virtual environment.

    python -m experiments.speed.loading --scenes 85
    python -m experiments.speed.loading --devkit /path/to/venv/bin/python
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import tyro

CAMERAS = ("CAM_BACK", "CAM_BACK_LEFT", "CAM_BACK_RIGHT", "CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT")
RATE_HZ = dict.fromkeys(CAMERAS, 12.0) | {"LIDAR_TOP": 20.0} | {f"RADAR_{i}": 12.6 for i in range(5)}
SECONDS = 20
KEYFRAMES = 40

MEASURE = """
import resource, sys, time
from pathlib import Path
start = time.process_time()
{work}
print(time.process_time() - start, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""

DEVKIT_WAY = """
import json
tables = {{}}
for name in ("scene", "log", "sample", "sensor", "calibrated_sensor", "sample_data", "ego_pose"):
    tables[name] = json.loads((Path({folder!r}) / (name + ".json")).read_text())
row_of_token = {{name: {{row["token"]: i for i, row in enumerate(rows)}} for name, rows in tables.items()}}
sensors = {{row["token"]: row for row in tables["sensor"]}}
calibrated = {{row["token"]: row for row in tables["calibrated_sensor"]}}
samples = {{row["token"]: row | {{"data": {{}}}} for row in tables["sample"]}}
for row in tables["sample_data"]:
    sensor = sensors[calibrated[row["calibrated_sensor_token"]]["sensor_token"]]
    row["sensor_modality"], row["channel"] = sensor["modality"], sensor["channel"]
    if row["is_key_frame"]:
        samples[row["sample_token"]]["data"][sensor["channel"]] = row["token"]
"""

OUR_WAY = """
from mixo_env.nuscenes.tables import open_dataset
open_dataset(Path({root!r})).reel("scene-0001", "CAM_FRONT")
"""

INSPECT = """
from mixo_env.cli.main import main
main(["inspect", {root!r}])
"""

DEVKIT = """
from nuscenes.nuscenes import NuScenes
NuScenes("v1.0-trainval", {root!r}, verbose=False)
"""


@dataclass(frozen=True)
class Loading:
    """Compare loaders."""

    scenes: int = 85
    """Scenes to write: 85 is a tenth of trainval, 200 MB of tables."""
    devkit: Path | None = None
    """Python of a virtual environment with nuscenes-devkit."""

    def run(self) -> int:
        """Write tables, measure, print CPU seconds, peak memory and ratios."""
        with tempfile.TemporaryDirectory() as name:
            root = Path(name)
            rows = write_tables(root, self.scenes)
            size_mb = sum(path.stat().st_size for path in (root / "v1.0-trainval").iterdir()) / 1e6
            print(f"{self.scenes} scenes, {rows:,} sample_data rows, {size_mb:.0f} MB of tables")
            peer = measure(sys.executable, DEVKIT_WAY.format(folder=str(root / "v1.0-trainval")))
            report("devkit's way (json, indices)", peer, peer)
            ours = OUR_WAY.format(root=str(root))
            report("mixo, first opening", measure(sys.executable, ours), peer)
            report("mixo, later openings", measure(sys.executable, ours), peer)
            inspect = INSPECT.format(root=str(root))
            shutil.rmtree(root / ".mixo-cache")
            report("mixo inspect, first run", measure(sys.executable, inspect), peer)
            report("mixo inspect, later runs", measure(sys.executable, inspect), peer)
            if self.devkit:
                report("nuscenes-devkit itself", measure(str(self.devkit), DEVKIT.format(root=str(root))), peer)
            cache = next((root / ".mixo-cache").iterdir())
            print(f"cache: {cache.stat().st_size / 1e6:.1f} MB")
        return 0


def measure(python: str, work: str) -> tuple[float, float]:
    """CPU seconds (imports included) and peak memory in MB of a fresh process."""
    done = subprocess.run([python, "-c", MEASURE.format(work=work)], capture_output=True, text=True, check=True)
    seconds, megabytes = done.stdout.split()[-2:]
    return float(seconds), float(megabytes)


def report(label: str, result: tuple[float, float], peer: tuple[float, float]) -> None:
    """Print one row."""
    ratios = f"{peer[0] / result[0]:6.1f}x faster, {peer[1] / result[1]:5.1f}x less memory"
    print(f"{label:30} {result[0]:7.2f} s CPU  {result[1]:7.0f} MB  {ratios}")


def write_tables(root: Path, scenes: int) -> int:
    """Tables of ``scenes`` scenes in the layout of the published files; returns the number of sample_data rows."""
    folder = root / "v1.0-trainval"
    folder.mkdir(parents=True)
    (root / "maps").mkdir()
    (root / "maps" / "none.png").touch()  # the devkit asks that it exists
    writers = {
        name: _Table(folder / f"{name}.json")
        for name in ("scene", "log", "sample", "sensor", "calibrated_sensor", "sample_data", "ego_pose", "map")
    }
    for name in ("category", "attribute", "visibility", "instance", "sample_annotation"):
        _Table(folder / f"{name}.json").close()
    sensor = {channel: _token("sensor", i) for i, channel in enumerate(RATE_HZ)}
    for channel, key in sensor.items():
        modality = "camera" if channel in CAMERAS else "other"
        writers["sensor"].add({"token": key, "channel": channel, "modality": modality})
    log = _token("log", 0)
    logfile = "n015-2018-07-24-11-22-45+0800"
    writers["log"].add(
        {"token": log, "logfile": logfile, "vehicle": "n015", "date_captured": "2018-07-24", "location": "singapore"}
    )
    writers["map"].add({"token": _token("map", 0), "log_tokens": [log], "category": "", "filename": "maps/none.png"})
    rows = sum(_write_scene(writers, scene, log, logfile, sensor) for scene in range(1, scenes + 1))
    for writer in writers.values():
        writer.close()
    return rows


def _write_scene(writers: dict[str, _Table], scene: int, log: str, logfile: str, sensor: dict[str, str]) -> int:
    """Rows of one scene; returns the number of its images and scans."""
    begin = 1_532_402_927_000_000 + scene * 30_000_000
    samples = [_token("sample", scene * 1000 + i) for i in range(KEYFRAMES)]
    writers["scene"].add(
        {
            "token": _token("scene", scene),
            "log_token": log,
            "nbr_samples": KEYFRAMES,
            "first_sample_token": samples[0],
            "last_sample_token": samples[-1],
            "name": f"scene-{scene:04d}",
            "description": "Parked truck, construction, intersection",
        }
    )
    for i, key in enumerate(samples):
        writers["sample"].add(
            {
                "token": key,
                "timestamp": begin + i * 500_000,
                "prev": samples[i - 1] if i else "",
                "next": samples[i + 1] if i + 1 < KEYFRAMES else "",
                "scene_token": _token("scene", scene),
            }
        )
    for j, channel in enumerate(RATE_HZ):
        row = {
            "token": _token("calibrated", scene * 100 + j),
            "sensor_token": sensor[channel],
            "translation": [1.7, 0.01, 1.5],
            "rotation": [0.5, -0.5, 0.5, -0.5],
            "camera_intrinsic": [[1266.4, 0.0, 816.3], [0.0, 1266.4, 491.5], [0.0, 0.0, 1.0]] * (channel in CAMERAS),
        }
        writers["calibrated_sensor"].add(row)
        _write_channel(writers, (scene * 20 + j) << 12, channel, begin, (row["token"], logfile, samples))
    return sum(int(rate * SECONDS) for rate in RATE_HZ.values())


def _write_channel(
    writers: dict[str, _Table], first: int, channel: str, begin: int, of: tuple[str, str, list[str]]
) -> None:
    """Images or scans of one sensor in one scene, and a pose for each; ``of``: calibration, log file, samples."""
    calibrated, logfile, samples = of
    is_camera = channel in CAMERAS
    count = int(RATE_HZ[channel] * SECONDS)
    for i in range(count):
        key = _token("data", first + i)
        time = begin + int(i * 1e6 / RATE_HZ[channel])
        is_key = i % max(1, count // KEYFRAMES) == 0
        folder_name = "samples" if is_key else "sweeps"
        writers["sample_data"].add(
            {
                "token": key,
                "sample_token": samples[min(KEYFRAMES - 1, i * KEYFRAMES // count)],
                "ego_pose_token": key,
                "calibrated_sensor_token": calibrated,
                "timestamp": time,
                "fileformat": "jpg",
                "is_key_frame": is_key,
                "height": 900 * is_camera,
                "width": 1600 * is_camera,
                "filename": f"{folder_name}/{channel}/{logfile}__{channel}__{time}.jpg",
                "prev": _token("data", first + i - 1) if i else "",
                "next": _token("data", first + i + 1) if i + 1 < count else "",
            }
        )
        writers["ego_pose"].add(
            {
                "token": key,
                "timestamp": time,
                "rotation": [0.5720320396729045, -0.0016977771610471074, 0.011798001930183783, -0.8201446642457809],
                "translation": [411.3039349319818 + 0.01 * i, 1180.8903791765097, 0.0],
            }
        )


class _Table:
    """One JSON array, a key per line, written row by row."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("w", encoding="utf-8")
        self._file.write("[\n")
        self._is_empty = True

    def add(self, row: dict[str, object]) -> None:
        self._file.write(("" if self._is_empty else ",\n") + json.dumps(row, indent=0))
        self._is_empty = False

    def close(self) -> None:
        self._file.write("\n]")
        self._file.close()


def _token(kind: str, number: int) -> str:
    """32 digits, distinct for each kind and number."""
    return f"{sum(map(ord, kind)):08x}{number * 0x9E3779B97F4A7C15 % 2**64:016x}{number:08x}"


if __name__ == "__main__":
    sys.exit(tyro.cli(Loading, description=__doc__).run())
