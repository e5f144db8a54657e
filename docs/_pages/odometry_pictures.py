"""Pictures of what the single-camera odometry sees and says. Agg only: no window is opened."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.experts.expert import CameraStep, State
from mixo_env.experts.monocular.camera import MountedCamera
from mixo_env.experts.monocular.kinematics import camera_displacement
from mixo_env.experts.monocular.motion import Motion
from mixo_env.experts.monocular.pair import PairSolver
from mixo_env.geometry import rotation_from_roll_pitch_yaw, rotation_from_yaw

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FloatArray = NDArray[np.float64]

KEPT, REJECTED, MOVER, MODEL = "#39d0c8", "#ff9d2e", "#ff3fa4", "white"
STATE_COLOURS = {State.INITIALISING: "#d62728", State.TRACKING: "#b9dcc0", State.LOST: "#1f4fd8"}
"""As in the paper's Fig. 4: red while initialising, blue while lost."""

CAMERA_COLOURS = {
    "CAM_FRONT": "#0072B2",
    "CAM_FRONT_LEFT": "#56B4E9",
    "CAM_BACK": "#009E73",
    "CAM_BACK_RIGHT": "#CC79A7",
}
EPIPOLAR_LINES = 24
NEAREST_M = 3.0


@dataclass(frozen=True)
class PairView:
    """Two images of one camera and what the odometry made of them.

    Attributes:
        name: of the camera.
        image: ``(height, width)`` the first image, grey, of the calibrated size.
        first_px, second_px: ``(n, 2)`` aligned matches in it and in the second image [px].
        motion: of the car between the two; ``None`` when none was found.
        matches: number of matched features.
        truth_rad: true yaw increment.
        distance_m: travelled between the images.
        camera: calibration and mounting.
        movers: ``(n,)`` bool, matches within the outline of a moving vehicle; ``None`` where nobody knows.
    """

    name: str
    image: NDArray[np.uint8]
    first_px: FloatArray
    second_px: FloatArray
    motion: Motion | None
    matches: int
    truth_rad: float
    distance_m: float
    camera: MountedCamera
    movers: NDArray[np.bool_] | None = None


def compare(
    name: str,
    solver: PairSolver,
    images: tuple[NDArray[np.uint8], NDArray[np.uint8]],
    gap_s: float,
    distance_m: float,
    truth_rad: float,
) -> PairView:
    """Look at two grey images ``(height, width)`` as the odometry does."""
    camera = solver.camera
    first, second = (solver.frame(camera.shrink(image)) for image in images)
    pair = solver.compare(first, second, gap_s, distance_m)
    return PairView(
        name,
        images[0],
        pixels(camera, pair.first),
        pixels(camera, pair.second),
        pair.motion,
        pair.matches,
        truth_rad,
        distance_m,
        camera,
    )


def pixels(camera: MountedCamera, plane: FloatArray) -> FloatArray:
    """Pixels ``(n, 2)`` of the full image from points ``(n, 2)`` on the image plane (unit focal length)."""
    x, y = plane[:, 0] + camera.skew_px / camera.focal_px[0] * plane[:, 1], plane[:, 1]
    return np.stack([x, y], axis=1) * camera.focal_px + camera.centre_px


def epipolar_segments(view: PairView, chosen: NDArray[np.intp]) -> FloatArray:
    """Where the estimated motion allows the first points of some matches to be.

    Args:
        view: with a motion.
        chosen: ``(k,)`` indices of matches.

    Returns:
        ``(k, 2, 2)`` px in the first image: the place of an infinitely far point, and of one ``NEAREST_M`` away.
    """
    motion, camera = view.motion, view.camera
    if motion is None or not len(chosen):
        return np.empty((0, 2, 2))
    turn = rotation_from_roll_pitch_yaw(motion.roll_rad, motion.pitch_rad, motion.yaw_rad)
    from_second = camera.rotation.T @ turn @ camera.rotation
    x, y = camera_displacement(motion.yaw_rad, view.distance_m, *map(float, camera.position_m[:2]))
    displacement = camera.rotation.T @ np.array([x, y + motion.slip_m, motion.heave_m])
    rays = np.column_stack([_plane(camera, view.second_px[chosen]), np.ones(len(chosen))]) @ from_second.T
    ends = [rays + inverse_depth * displacement for inverse_depth in (0.0, 1.0 / NEAREST_M)]
    return np.stack([pixels(camera, end[:, :2] / end[:, 2:]) for end in ends], axis=1)


def _plane(camera: MountedCamera, px: FloatArray) -> FloatArray:
    y = (px[:, 1] - camera.centre_px[1]) / camera.focal_px[1]
    return np.column_stack([(px[:, 0] - camera.centre_px[0] - camera.skew_px * y) / camera.focal_px[0], y])


def draw_pairs(views: Sequence[PairView], columns: int = 2) -> Figure:
    """One panel per pair: matches as short lines from the first to the second image, and what the motion allows."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = -(-len(views) // columns)
    height, width = views[0].image.shape
    figure = Figure(figsize=(7.0 * columns, (7.0 * height / width + 0.45) * rows + 0.3), layout="constrained")
    FigureCanvasAgg(figure)
    axes: Any = figure.subplots(rows, columns, squeeze=False)
    for axis, view in zip(axes.flat, views, strict=False):
        _draw_pair(axis, view)
    for axis in axes.flat[len(views) :]:
        axis.set_axis_off()
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), fontsize=10, facecolor="0.35",
                  labelcolor="white")  # fmt: skip
    return figure


def _draw_pair(axis: Axes, view: PairView) -> None:
    from matplotlib.collections import LineCollection

    height, width = view.image.shape
    axis.imshow(view.image, cmap="gray", vmin=0, vmax=330, interpolation="antialiased")  # darker: the lines matter
    kept = np.zeros(len(view.first_px), np.bool_) if view.motion is None else view.motion.inlier
    movers = np.zeros(len(kept), np.bool_) if view.movers is None else view.movers
    spread = np.flatnonzero(kept)[:: max(1, int(kept.sum()) // EPIPOLAR_LINES)]
    lines = epipolar_segments(view, spread)
    axis.add_collection(LineCollection(list(lines), colors=MODEL, linewidths=0.6, alpha=0.8, label="epipolar lines"))
    axis.plot(*view.first_px[spread].T, ".", color=MODEL, markersize=2.5)
    segments = np.stack([view.first_px, view.second_px], axis=1)
    for chosen, colour, label in (
        (kept, KEPT, "kept"),
        (~kept & ~movers, REJECTED, "rejected"),
        (~kept & movers, MOVER, "rejected, on a moving vehicle"),
    ):
        if colour != MOVER or view.movers is not None:
            axis.add_collection(LineCollection(list(segments[chosen]), colors=colour, linewidths=1.3, label=label))
    axis.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), xticks=[], yticks=[])
    found = "no motion found"
    if view.motion is not None:
        yaw, std = np.degrees([view.motion.yaw_rad, view.motion.yaw_std_rad])
        found = f"yaw {yaw:+.3f} ± {std:.3f}°"
    on_movers = "" if view.movers is None else f", {int((kept & movers).sum())} kept on movers"
    axis.set_title(
        f"{view.name}   {found}, true {np.degrees(view.truth_rad):+.3f}°   {kept.mean():.0%} of {len(kept)} kept"
        f"{on_movers}",
        fontsize=10,
    )


@dataclass(frozen=True)
class Track:
    """One camera over a scene: ``n`` images, the steps of its odometry, and the true yaw increments [rad]."""

    name: str
    time_s: FloatArray
    steps: Sequence[CameraStep]
    truth_rad: FloatArray


def draw_states(tracks: Sequence[Track], covered: str, covered_s: tuple[float, float]) -> Figure:
    """Yaw rate of every camera against the truth, and below it the states; one camera is covered for a while."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    figure = Figure(figsize=(9.0, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    rate, state = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1.3))
    for row, track in enumerate(tracks):
        gap_s = np.diff(track.time_s)
        estimate = np.degrees([step.yaw_increment_rad for step in track.steps[1:]]) / gap_s
        if row == 0:
            rate.plot(track.time_s[1:], np.degrees(track.truth_rad) / gap_s, color="0.2", linewidth=3, alpha=0.35,
                      label="truth")  # fmt: skip
        rate.plot(track.time_s[1:], estimate, ".-", color=CAMERA_COLOURS.get(track.name), linewidth=1, markersize=4,
                  label=track.name)  # fmt: skip
        edges = np.append(track.time_s, track.time_s[-1] + np.median(gap_s))
        colours = [STATE_COLOURS[step.state] for step in track.steps]
        state.bar(edges[:-1], 0.8, np.diff(edges), row - 0.4, align="edge", color=colours)
    for axis in (rate, state):
        axis.axvspan(*covered_s, color="0.5", alpha=0.2, linewidth=0)
    at = (sum(covered_s) / 2.0, 0.97)
    rate.text(*at, f"{covered}\ncovered", transform=rate.get_xaxis_transform(), ha="center", va="top", fontsize=8)
    rate.set(ylabel="yaw rate [deg/s]")
    rate.grid(alpha=0.3)
    rate.legend(fontsize=8, loc="best")
    state.set(xlabel="time [s]", yticks=range(len(tracks)), ylim=(len(tracks) - 0.5, -0.5))
    state.set_yticklabels([track.name for track in tracks], fontsize=8)
    handles = [Patch(color=colour, label=kind.name) for kind, colour in STATE_COLOURS.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=8)
    return figure


def draw_frames() -> Figure:
    """The car before and after a step, seen from above: arc, yaw, lever arm and displacement of a camera."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    yaw, distance, lever = np.radians(38.0), 7.5, (1.6, 0.9)
    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    axis: Any = figure.subplots()
    arc = np.array([camera_displacement(part * yaw, part * distance, 0.0, 0.0) for part in np.linspace(0.0, 1.0, 40)])
    axis.plot(*arc.T, color="0.45", linewidth=1.5, linestyle="--")
    axis.annotate("arc of length s", arc[24], (8, -12), textcoords="offset points", color="0.35")
    cameras = []
    for number, (origin, heading) in enumerate(((np.zeros(2), 0.0), (arc[-1], yaw))):
        turn = rotation_from_yaw(heading)[:2, :2]
        corners = np.array([[-0.6, -0.95], [3.4, -0.95], [3.4, 0.95], [-0.6, 0.95], [-0.6, -0.95]])
        axis.plot(*(origin + corners @ turn.T).T, color="0.75")
        for direction, name in ((turn[:, 0], "x"), (turn[:, 1], "y")):
            tip = origin + 2.2 * direction
            axis.annotate("", tip, origin, arrowprops={"arrowstyle": "->", "color": "black"})
            axis.annotate(f"{name}$_{{k{'-1' if number == 0 else ''}}}$", tip, (2, 2), textcoords="offset points")
        cameras.append(origin + turn @ np.array(lever))
        axis.plot(*np.array([origin, cameras[-1]]).T, color=CAMERA_COLOURS["CAM_BACK"])
        axis.plot(*cameras[-1], "o", color=CAMERA_COLOURS["CAM_FRONT"])
    axis.annotate("lever arm", cameras[0] / 2.0, (10, -2), textcoords="offset points",
                  color=CAMERA_COLOURS["CAM_BACK"])  # fmt: skip
    axis.annotate("", cameras[1], cameras[0],
                  arrowprops={"arrowstyle": "->", "color": CAMERA_COLOURS["CAM_FRONT"], "linewidth": 2})  # fmt: skip
    axis.annotate("t: displacement\nof the camera", (cameras[0] + cameras[1]) / 2.0, (-6, 6),
                  textcoords="offset points", ha="right", color=CAMERA_COLOURS["CAM_FRONT"])  # fmt: skip
    around = np.array([[np.cos(a), np.sin(a)] for a in np.linspace(0.0, yaw, 20)])
    axis.plot([arc[-1][0], arc[-1][0] + 2.6], [arc[-1][1]] * 2, color="0.6", linewidth=0.8)
    axis.plot(*(arc[-1] + 1.9 * around).T, color="black", linewidth=0.8)
    axis.annotate(r"$\Delta\psi_k$", arc[-1] + 2.05 * around[10], (2, -3), textcoords="offset points")
    axis.set_aspect("equal")
    axis.set_axis_off()
    return figure
