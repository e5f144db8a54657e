"""Write docs/odometry.md: how the single-camera odometry works, with pictures of a simulated drive it makes itself.

    python -m docs._pages.odometry_page                          the page
    python -m docs._pages.odometry_page --root /data/kitti/06    and the same picture of your own images

Pictures of other data than the simulated go to ``results/odometry`` and are no part of the page. With the environment
variable ``MIXO_REAL_DATA`` set, its ``kitti_06`` is drawn without being asked for.
"""

from __future__ import annotations

import inspect
import os
import re
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import tyro
from numpy.typing import NDArray

from docs._pages.experts_section import experts_section
from docs._pages.joint_section import JOINT_TEXT
from docs._pages.odometry_pictures import NEAREST_M, PairView, Track, compare, draw_frames, draw_pairs, draw_states
from experiments.calibration import collect, draw
from experiments.speed.drives import Drive, open_drives
from mixo_env.cli.results import RESULTS
from mixo_env.errors import MixoError
from mixo_env.experts.expert import CameraStep
from mixo_env.experts.monocular.camera import mount
from mixo_env.experts.monocular.config import PRESETS, MonocularConfig
from mixo_env.experts.monocular.odometry import MonocularOdometry
from mixo_env.experts.monocular.pair import PairSolver
from mixo_env.files import atomic_path, write_text
from mixo_env.nuscenes.scene import CameraCalibration
from mixo_env.nuscenes.selections import CAMERAS
from mixo_env.recordings.store import load_recordings
from mixo_env.simulator.city.vehicles import VEHICLE_KINDS, VehicleState
from mixo_env.simulator.config import SimulationConfig

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DOCS = Path(__file__).parents[1]
SHOWN = SimulationConfig(scenes=1, seconds=4, seed=50, rain=0.0, night=0.0, low_texture=0.0)
"""A right turn among moving vehicles."""
SHOWN_S = 2.5
"""The pair that is drawn is the first after this time."""
COVERED = "CAM_FRONT"
COVERED_S = (1.5, 2.0)
"""Between these times a camera is shown black images, so that the states are seen."""

MOVING_MPS = 0.5
SURFACE_STEPS = 12


def attributes(documented: type) -> dict[str, str]:
    """Name -> meaning from the "Attributes" section of a docstring."""
    section = inspect.cleandoc(documented.__doc__ or "").partition("Attributes:\n")[2]
    found: dict[str, str] = {}
    for names, meaning in re.findall(r"^    (\w[\w, ]*): ((?:.*\n?)(?:^        .*\n?)*)", section, re.MULTILINE):
        found |= dict.fromkeys(names.split(", "), " ".join(meaning.split()))
    return found


def settings_table() -> str:
    """Every setting with its value in both presets, in Markdown."""
    meaning = attributes(MonocularConfig)
    rows = [f"| setting | {' | '.join(f'`{name}`' for name in PRESETS)} | meaning |", "|---|---|---|---|"]
    for field in fields(MonocularConfig):
        values = [getattr(preset, field.name) for preset in PRESETS.values()]
        cells = " | ".join("-" if value is None else f"{value}" for value in values)
        rows.append(f"| `{field.name}` | {cells} | {_spelt(meaning[field.name])} |")
    return "\n".join(rows)


def signals_table() -> str:
    """What the odometry says about every image, in Markdown."""
    rows = ["| signal | meaning |", "|---|---|"]
    return "\n".join(rows + [f"| `{name}` | {_spelt(meaning)} |" for name, meaning in attributes(CameraStep).items()])


def _spelt(meaning: str) -> str:
    """Markup of docstrings as that of Markdown."""
    return meaning.replace("``", "`").replace("|", "\\|")


def pair_at(drive: Drive, time_s: float, config: MonocularConfig) -> tuple[int, PairView]:
    """The number of the first image after ``time_s`` that has a next one, and how the odometry sees the two."""
    time = 1e-6 * (drive.timestamp_us - drive.timestamp_us[0])
    i = min(int(np.searchsorted(time, time_s)), len(time) - 2)
    solver = PairSolver(mount(drive.calibration, config.max_pixels), config)
    images = drive.read(drive.image_paths[i]), drive.read(drive.image_paths[i + 1])
    view = compare(
        drive.calibration.channel,
        solver,
        images,
        float(time[i + 1] - time[i]),
        float(drive.path_m[i]),
        float(drive.turn_rad[i]),
    )
    return i, view


def tracked(drive: Drive, config: MonocularConfig, covered_s: tuple[float, float] | None) -> Track:
    """The odometry over a whole drive, with the true distances."""
    odometry = MonocularOdometry(drive.calibration, config)
    time = 1e-6 * (drive.timestamp_us - drive.timestamp_us[0])
    steps = []
    for at, path, stamp, metres in zip(time, drive.image_paths, drive.timestamp_us, [0.0, *drive.path_m], strict=True):
        image = drive.read(path)
        if covered_s is not None and covered_s[0] <= at < covered_s[1]:
            image = np.zeros_like(image)
        steps.append(odometry.process(image, int(stamp), float(metres)))
    return Track(drive.calibration.channel, time, steps, drive.turn_rad)


def outline(
    calibration: CameraCalibration,
    rotation_map_from_camera: NDArray[np.float64],
    position_m: NDArray[np.float64],
    vehicle: VehicleState,
) -> NDArray[np.float32]:
    """Convex outline ``(k, 2)`` px of a vehicle's box in an image; empty when it is behind the camera."""
    kind = VEHICLE_KINDS[vehicle.kind]
    grid = np.linspace(-0.5, 0.5, SURFACE_STEPS)
    u, v, w = (part.ravel() for part in np.meshgrid(grid, grid, grid + 0.5))
    forward = np.array([np.cos(vehicle.yaw_rad), np.sin(vehicle.yaw_rad), 0.0])
    left = np.array([-forward[1], forward[0], 0.0])
    centre = np.array([vehicle.x_m, vehicle.y_m, 0.0])
    box = centre + np.outer(u * kind.length_m, forward) + np.outer(v * kind.width_m, left)
    box[:, 2] += w * kind.height_m
    seen = (box - position_m) @ rotation_map_from_camera
    seen = seen[seen[:, 2] > 0.3]
    if len(seen) < 3:
        return np.empty((0, 2), np.float32)
    px = (seen / seen[:, 2:]) @ calibration.intrinsic.T
    return np.asarray(cv2.convexHull(px[:, :2].astype(np.float32))[:, 0], np.float32)


def inside(points_px: NDArray[np.float64], outlines: Sequence[NDArray[np.float32]]) -> NDArray[np.bool_]:
    """``(n,)``: the point lies in one of the outlines."""
    return np.array(
        [any(cv2.pointPolygonTest(edge, (float(x), float(y)), False) >= 0 for edge in outlines) for x, y in points_px],
        np.bool_,
    )


def simulated(folder: Path, config: MonocularConfig) -> tuple[list[PairView], list[Track]]:
    """Simulate the short scene; its pairs with what moves marked, and its tracks."""
    from mixo_env.simulator.dataset import simulate
    from mixo_env.simulator.drive.scenario import plan_logs
    from mixo_env.simulator.drive.scenes import camera_pose, simulate_scene

    simulate(SHOWN, folder)
    (log,) = plan_logs(SHOWN)
    (plan,) = log.scenes
    scene = simulate_scene(SHOWN, log, plan, folder)
    views, tracks = [], []
    for drive in open_drives(folder, (), CAMERAS):
        i, view = pair_at(drive, SHOWN_S, config)
        mounting = log.rig.true[view.name]
        time_s = 1e-6 * (int(drive.timestamp_us[i]) - plan.start_us)
        pose = camera_pose(scene.drive, mounting.rotation_ego_from_camera, mounting.translation_m, time_s)
        moving = [state for vehicle in scene.vehicles if abs((state := vehicle.state(time_s)).speed_mps) > MOVING_MPS]
        edges = [outline(mounting, pose.rotation_map_from_camera, pose.position_m, state) for state in moving]
        edges = [edge for edge in edges if len(edge)]
        views.append(replace(view, movers=inside(view.first_px, edges)))
        tracks.append(tracked(drive, config, COVERED_S if view.name == COVERED else None))
    return views, tracks


def others(root: Path, config: MonocularConfig) -> list[PairView]:
    """One pair of every camera from the middle of the first scene of any data."""
    views: list[PairView] = []
    first = None
    for drive in open_drives(root, (), CAMERAS):
        first = first or drive.scene
        if drive.scene != first:
            break
        middle_s = 0.5e-6 * float(drive.timestamp_us[-1] - drive.timestamp_us[0])
        views.append(pair_at(drive, middle_s, config)[1])
    return views


TEXT = r"""# Single-camera odometry

<!-- Written by `python -m docs._pages.odometry_page`; change that. -->

One camera of the car, its calibration, and the distance the wheels travelled go in; the yaw increment of the car since
the camera's previous image comes out, with a standard deviation, or the word that the camera is lost. The code is
`mixo_env.experts.monocular`; `MonocularOdometry` is the expert, `PairSolver` compares two images.

![Matches of one pair of images of each camera](figures/odometry-pairs.jpg)

Two consecutive images of each of the paper's cameras in a simulated right turn, the first one shown. Every match is a
line from where a point was to where it is. White: for some of the kept matches, where the estimated motion allows the
point to have been, from infinitely far away to {nearest:g} m; the dot is where it was. The numbers are those of this
pair alone. Vehicles that move are known to the simulator, not to the odometry.

With images of your own, `python -m docs._pages.odometry_page --root FOLDER` draws the same in `results/odometry`, for a
nuScenes folder or a KITTI sequence.

## From images to an increment

1. *Shrink.* Images above `max_pixels` are halved. (`MountedCamera` also checks the calibration.)
2. *Corners.* FAST on a pyramid, cell by cell, so that they spread evenly: the contrast threshold is
   `fast_threshold`, and `fast_threshold_low` where a cell has too few. Each corner has an orientation and a binary
   descriptor of 256 bits.
3. *Words.* A vocabulary tree sorts descriptors; only corners of like words are compared, which takes milliseconds
   instead of a second. A general vocabulary ships; `mixo train-vocabulary` learns one of your own images.
4. *Match.* Corners of consecutive images that are each other's nearest by descriptor, within reach, of about the same
   size and orientation, and clearly better than the second best.
5. *Align.* Descriptors say which corner, grey values say where: each match is moved to where its patch fits best, which
   makes it right to a twentieth of a pixel.
6. *Vote.* All yaw increments that a car can make over this distance are tried; the one most matches agree with wins.
   One unknown needs no sampling, so the result is always the same.
7. *Refine.* All unknowns of the motion together, by iteratively reweighted least squares; matches on moving vehicles
   and wrong matches lose their weight.
8. *Course and turn.* Two images of a side view hardly tell a turn from a sideways motion. But a car moves sideways in a
   regular way: course and heading differ by an angle that is nearly constant over minutes. Its slow mean, and that of
   heave, are learnt from earlier pairs and replace the wide prior of a pair alone. Nor can a car change its yaw rate at
   will: the rate of the last pair is expected of the next, within `yaw_acceleration_radps2`. Then the pair is refined
   once more. The increment without this memory is recorded beside it, as `two_frame_yaw_increment_rad`.
9. *Three images.* Where points of the last pair are seen again, a local bundle adjustment of the three images measures
   how much more or less the car turns than in the last pair: more exactly than any pair measures its own turn, and also
   where traffic fills the view.
10. *Heading.* A Kalman filter joins pairs and changes. What it learns about pairs already reported is added to the next
    increment, so that the sum of the increments is the best heading known.

No measured yaw rate enters anywhere; a test changes every gyro of the car and finds these increments the same to the
last bit. The distance does enter: it is the scale.

`python -m experiments.speed.odometry FOLDER` measures it on a nuScenes folder or a KITTI sequence, with `--peer`
beside ORB-SLAM3 on the same images (`experiments/peers`: its own process and virtual environment, never imported).

## The motion between two images

![The car before and after a step, from above](figures/odometry-frames.png)

Frames and units: ego axes x forward, y left, z up, origin under the middle of the rear axle; camera axes x right,
y down, z forward; metres, radians, seconds; yaw is positive to the left. The first image was taken in ego frame k-1,
the second in ego frame k. $C$ is the rotation from camera to ego axes and $l$ the place of the camera, its lever arm.

The rear axle follows an arc of known length $s$ and unknown turn $\Delta\psi$; the body may tilt a little, and the
tyres slip. With $R = R_z(\Delta\psi) R_y(\text{{pitch}}) R_x(\text{{roll}})$ the camera is displaced by

$$t = \operatorname{{arc}}(\Delta\psi, s) + (R_z(\Delta\psi) - I)\, l + (0, \text{{slip}}, \text{{heave}})^\top$$

and a point seen at $h_2 = (u, v, 1)^\top$ on the second image plane, at inverse depth $\rho$, was seen on the first at

$$h_1 \sim C^\top R\, C\, h_2 + \rho\, C^\top t.$$

As $\rho$ runs from zero (infinitely far) upwards, $h_1$ runs along the point's epipolar line. The error of a match is
therefore split: *across* that line it is the noise of the position; *along* it, it is noise plus the unknown depth,
for which only a mean and a spread are assumed. When the camera has moved far, only the part across the line tells
something; when the car stands, both do. So driving, creeping, turning on the spot and standing still are one estimator
without a switch. Matches that would lie behind the camera, absurdly near, or below the road are wrong.

Soft zero priors hold pitch and roll (`tilt_std_rad`) and slip and heave (`slip_std`); the mean inverse depth of the
scene is the sixth unknown. The standard deviation of the yaw is that of the least squares, enlarged because the errors
of neighbouring matches are alike.

## States

![Yaw rate of four cameras, and their states](figures/odometry-states.png)

A pair of images is *good* when it has `min_matches` matches, `min_inliers` of them agree with the motion, and the
standard deviation is below `max_yaw_std_rad`.

* INITIALISING: from the first image until `initial_pairs` good pairs came in a row, with `initial_matches` matches
  each, while the car travelled `initial_distance_m`; a car that stands gives no parallax, and is let in after
  `initial_patience_pairs`.
* TRACKING: while pairs stay good; the only state with an increment.
* LOST: from the first pair that is not good, after a turn that no car can make (a vehicle that drives past fills the
  view), at the second pair in a row that alone contradicts the expected turn, after a gap longer than `max_gap_s`, or
  when the image does not change although the car moves. The next good pair is INITIALISING again.

A recording keeps what the expert said; what stands in for a lost camera is decided later, by the environment (its
option `lost`). The row *w/o inertial initialization* of the paper is zero yaw and distance until the first TRACKING.

## What is said about every image

{signals}

## Settings

`fast` is the default, `paper` has the sizes the paper gives.

{settings}

## How good it is

`python -m experiments.speed.odometry FOLDER` prints accuracy, share tracked and speed for every camera of a
nuScenes folder or a KITTI sequence, beside ORB-SLAM3 where that is installed, and how much the yaw depends on the
distance (`--rescale`); errors are against the simulator's exact truth, or the poses of real data.
`python -m experiments.speed.matching` compares the matcher with brute force. The pictures of this page were made
with exact distances.
"""


def page() -> str:
    """The text of the page."""
    own = TEXT.format(nearest=NEAREST_M, signals=signals_table(), settings=settings_table())
    return own + JOINT_TEXT + experts_section(collect(load_recordings()))


def _save(figure: Figure, path: Path, dpi: int) -> None:
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=dpi, format=path.suffix[1:])


@dataclass(frozen=True)
class OdometryPage:
    """Write docs/odometry.md and its figures, from a simulation of four seconds that takes about half a minute.

    Example: python -m docs._pages.odometry_page
    """

    root: Path | None = None
    """Draw a pair of these images, too: a nuScenes folder or a KITTI sequence; into results/odometry.
    None: kitti_06 of MIXO_REAL_DATA, if that is set."""
    out: Path = DOCS
    """Folder of the page; the figures go into its folder figures."""

    def run(self) -> int:
        """Simulate, look, draw, write."""
        config = MonocularConfig()
        with tempfile.TemporaryDirectory() as folder:
            views, tracks = simulated(Path(folder) / "drive", config)
        figures = self.out / "figures"
        _save(draw_pairs(views), figures / "odometry-pairs.jpg", dpi=80)
        _save(draw_states(tracks, COVERED, COVERED_S), figures / "odometry-states.png", dpi=100)
        _save(draw_frames(), figures / "odometry-frames.png", dpi=80)
        draw(collect(load_recordings()), figures / "odometry-calibration.png")
        write_text(self.out / "odometry.md", page())
        print(f"wrote {self.out / 'odometry.md'} and its figures")

        root = self.root
        if root is None and "MIXO_REAL_DATA" in os.environ:
            kitti = Path(os.environ["MIXO_REAL_DATA"]) / "kitti_06"
            root = kitti if kitti.is_dir() else None
        if root is not None:
            picture = RESULTS / "odometry" / f"{root.name}.jpg"
            views = others(root, config)
            _save(draw_pairs(views, columns=min(2, len(views))), picture, dpi=100)
            print(f"wrote {picture}: not the project's images, so no part of the page")
        return 0


if __name__ == "__main__":
    import sys

    try:
        sys.exit(tyro.cli(OdometryPage, description=__doc__).run())
    except MixoError as error:
        sys.exit(f"odometry_page: {error}")
