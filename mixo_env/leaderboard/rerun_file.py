"""One drive for the viewer Rerun (https://rerun.io): a .rrd file, or the viewer itself, on the timeline ``time_s``.

| entity | what |
|---|---|
| ``world/truth``, ``world/ways/ROW`` | ways [m] from the true first pose, axes of the map; ``now``: the car |
| ``world/rig/CAMERA`` | frustum, image and matches, where a nuScenes folder is at hand |
| ``world/lost/CAMERA`` | true places at which a camera was lost |
| ``weights/POLICY/EXPERT`` | weight of the step that ends then |
| ``error_m/ROW`` | distance from the truth |
| ``matches/CAMERA``, ``lost/CAMERA`` | recorded count; 1 while lost, else 0 |
"""

from __future__ import annotations

import itertools
import os
import sys
import tempfile
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import ConfigurationError
from mixo_env.experts.expert import State
from mixo_env.files import write_bytes
from mixo_env.geometry import FloatArray
from mixo_env.leaderboard.figures import OTHERS, PREFERRED
from mixo_env.leaderboard.one_drive import OneDrive, OneWay
from mixo_env.leaderboard.rig import Rig
from mixo_env.recordings.presets import data_label

TIMELINE = "time_s"
TRUTH_COLOUR = "#8C929C"
DOT = -5.0
"""Radius of marks: below 0 it is in points of the screen."""

FRUSTUM_M = 1.5
"""Distance at which a camera's image is drawn."""

MOST_LINES = 300
"""Matches drawn on an image at most, evenly picked: more would hide it."""


def require_rerun() -> None:
    """See that the viewer's package is there, without loading it.

    Raises:
        ConfigurationError: when it is not.
    """
    if find_spec("rerun") is None:
        raise ConfigurationError("the viewer needs the package rerun-sdk: pip install 'mixo-env[view]'")


def write_rerun(path: Path, drive: OneDrive, rig: Rig | None, progress: Callable[[int, int], None]) -> None:
    """Write a .rrd file at once or not at all.

    Args:
        path: file to write.
        drive: what to show.
        rig: its cameras, where a nuScenes folder is at hand.
        progress: told how many cameras' images are done, of how many.

    Raises:
        ConfigurationError: without Rerun.
        OutputError: when it cannot be written.
    """
    recording, blueprint = _opened(drive, rig)
    with tempfile.TemporaryDirectory(prefix="mixo-view-") as folder:
        part = Path(folder) / "drive.rrd"
        recording.save(str(part), default_blueprint=blueprint)
        _log(recording, drive, rig, progress)
        recording.flush()
        recording.disconnect()
        write_bytes(path, part.read_bytes())


def open_viewer(drive: OneDrive, rig: Rig | None, progress: Callable[[int, int], None]) -> None:
    """Start Rerun's viewer and show the drive; it goes on without this process.

    Raises:
        ConfigurationError: without Rerun, without a display, or when its viewer does not start.
    """
    # Rerun would wait for a viewer for ever.
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise ConfigurationError("--spawn needs a display, and there is none: write a file with --out instead")
    recording, blueprint = _opened(drive, rig)
    try:
        recording.spawn(default_blueprint=blueprint)
    except (OSError, RuntimeError) as error:
        raise ConfigurationError(f"Rerun's viewer does not start ({error}): write a file with --out instead") from None
    _log(recording, drive, rig, progress)
    recording.flush()


def _opened(drive: OneDrive, rig: Rig | None) -> tuple[Any, Any]:
    """A recording of Rerun's, and how its views are arranged."""
    require_rerun()
    import rerun  # pyright: ignore[reportMissingImports]
    import rerun.blueprint as views  # pyright: ignore[reportMissingImports]

    cameras = tuple(rig.calibrations) if rig and rig.has_images else ()
    pictures = [views.Spatial2DView(origin=f"world/rig/{camera}", name=camera) for camera in cameras]
    left = [views.Spatial3DView(origin="world", name="ways from above")]
    left += [views.Grid(*pictures, grid_columns=2)] if pictures else []
    tabs: list[Any] = [
        views.TimeSeriesView(origin=_path("weights", way.name), name=f"weights of {way.name}")
        for way in drive.ways
        if way.experts
    ]
    tabs.append(views.TextDocumentView(origin="about", name="about"))
    plain = views.PlotLegend(visible=False)  # cameras have the colours that they have among the rows
    curves = [
        views.TimeSeriesView(origin="error_m", name="distance from the truth [m]"),
        views.TimeSeriesView(origin="matches", name="matches", plot_legend=plain),
        views.TimeSeriesView(origin="lost", name="lost cameras", plot_legend=plain),
    ]
    right = views.Vertical(views.Tabs(*tabs), *curves, row_shares=[3, 3, 2, 1])
    layout = views.Horizontal(views.Vertical(*left), right, column_shares=[3, 2])
    shut = (kind(state="collapsed") for kind in (views.SelectionPanel, views.BlueprintPanel))
    panels = views.TimePanel(timeline=TIMELINE, state="collapsed"), *shut
    return rerun.RecordingStream("mixo_env"), views.Blueprint(layout, *panels)


def _log(recording: Any, drive: OneDrive, rig: Rig | None, progress: Callable[[int, int], None]) -> None:
    """Everything of a drive into an open recording."""
    import rerun  # pyright: ignore[reportMissingImports]

    recording.log("world", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    recording.log("about", rerun.TextDocument(_about(drive), media_type="text/markdown"), static=True)
    others = itertools.cycle(OTHERS)
    _log_way(recording, drive, drive.truth, ("world", "truth"), TRUTH_COLOUR)
    for way in drive.ways:
        colour = PREFERRED.get(way.name) or next(others)
        _log_way(recording, drive, way, ("world", "ways", way.name), colour)
        _log_curve(recording, ("error_m", way.name), drive.time_s, drive.error_m(way), colour)
        for j, expert in enumerate(way.experts):
            colour = PREFERRED.get(expert, OTHERS[j % len(OTHERS)])
            _log_curve(recording, ("weights", way.name, expert), drive.time_s[1:], way.weights[:, j], colour)
    _log_cameras(recording, drive)
    if rig is not None:
        _log_rig(recording, drive, rig, progress)


def _log_way(recording: Any, drive: OneDrive, way: OneWay, parts: tuple[str, ...], colour: str) -> None:
    """The whole way, and where the car is."""
    import rerun  # pyright: ignore[reportMissingImports]

    places = places_m(drive, way)
    radius = -3.0 if way is drive.truth else -1.5  # below 0: points of the screen
    below = [0.0, 0.0, -0.05 if way is drive.truth else 0.0]  # the wide line of the truth must not hide the others
    line = rerun.LineStrips3D([places + below], colors=[_rgb(colour)], radii=[radius])
    recording.log(_path(*parts), line, static=True)
    label = rerun.Points3D.from_fields(colors=[_rgb(colour)], radii=[DOT], labels=[way.name], show_labels=False)
    recording.log(_path(*parts, "now"), label, static=True)
    _send(recording, (*parts, "now"), drive.time_s, rerun.Points3D.columns(positions=places))


def _log_curve(recording: Any, parts: tuple[str, ...], time_s: FloatArray, values: FloatArray, colour: str) -> None:
    """A number over time; moments without one are left out."""
    import rerun  # pyright: ignore[reportMissingImports]

    recording.log(_path(*parts), rerun.SeriesLines(colors=[_rgb(colour)], names=[parts[-1]]), static=True)
    there = np.isfinite(values)
    _send(recording, parts, time_s[there], rerun.Scalars.columns(scalars=values[there].astype(np.float64)))


def _log_cameras(recording: Any, drive: OneDrive) -> None:
    """Match counts and lost marks of cameras and imported experts."""
    import rerun  # pyright: ignore[reportMissingImports]

    recordings = drive.recordings
    places = places_m(drive, drive.truth)
    names = [*recordings.manifest.cameras, *recordings.manifest.imported]
    for j, camera in enumerate(name for name in names if f"{name}.state" in recordings):
        colour = PREFERRED.get(camera, OTHERS[j % len(OTHERS)])
        lost = recordings[f"{camera}.state"] == State.LOST
        _log_curve(recording, ("matches", camera), drive.time_s, recordings[f"{camera}.matches"], colour)
        _log_curve(recording, ("lost", camera), drive.time_s, lost.astype(np.float64), colour)
        raised = places[lost] + [0.0, 0.0, 0.5 * (j + 1)]  # one layer a camera: they are often lost together
        points = rerun.Points3D(raised, colors=[_rgb(colour)], radii=[DOT])
        recording.log(_path("world", "lost", camera), points, static=True)


def _log_rig(recording: Any, drive: OneDrive, rig: Rig, progress: Callable[[int, int], None]) -> None:
    """The car on its true way, its cameras, what they saw and what of it was found again."""
    import rerun  # pyright: ignore[reportMissingImports]

    yaw = drive.truth.yaw_rad
    turns = np.stack([np.zeros_like(yaw), np.zeros_like(yaw), np.sin(yaw / 2), np.cos(yaw / 2)], axis=1)  # x y z w
    poses = rerun.Transform3D.columns(translation=places_m(drive, drive.truth), quaternion=turns)
    _send(recording, ("world", "rig"), drive.time_s, poses)
    for done, (camera, calibration) in enumerate(rig.calibrations.items()):
        progress(done, len(rig.calibrations))
        path = _path("world", "rig", camera)
        mounted = rerun.Transform3D(translation=calibration.translation_m, mat3x3=calibration.rotation_ego_from_camera)
        width, height = rig.size_px(camera)
        small = np.diag([width / calibration.width, height / calibration.height, 1.0])
        lens = rerun.Pinhole(
            image_from_camera=small @ calibration.intrinsic,
            resolution=[width, height],
            camera_xyz=rerun.ViewCoordinates.RDF,
            image_plane_distance=FRUSTUM_M,
        )
        recording.log(path, mounted, lens, static=True)
        for look in rig.looks(camera) if rig.has_images else ():
            recording.set_time(TIMELINE, duration=float(drive.time_s[look.row]))
            recording.log(path, rerun.EncodedImage(contents=look.jpeg, media_type="image/jpeg"))
            few = look.matches[:: max(1, -(-len(look.matches) // MOST_LINES))]
            recording.log(
                _path("world", "rig", camera, "matches"), rerun.LineStrips2D(few, colors=[(40, 220, 90)], radii=[-0.7])
            )
        recording.reset_time()


def places_m(drive: OneDrive, way: OneWay) -> NDArray[np.float32]:
    """``(rows, 3)`` from the true first pose: maps are kilometres wide, and Rerun keeps float32."""
    x, y = way.x_m - drive.truth.x_m[0], way.y_m - drive.truth.y_m[0]
    return np.stack([x, y, np.zeros_like(x)], axis=1).astype(np.float32)


def _send(recording: Any, parts: tuple[str, ...], time_s: FloatArray, columns: Any) -> None:
    import rerun  # pyright: ignore[reportMissingImports]

    recording.send_columns(_path(*parts), indexes=[rerun.TimeColumn(TIMELINE, duration=time_s)], columns=columns)


def _path(*parts: str) -> str:
    """An entity's path; names of rows may hold blanks and slashes."""
    import rerun  # pyright: ignore[reportMissingImports]

    return rerun.new_entity_path(list(parts))


def _rgb(colour: str) -> tuple[int, ...]:
    return tuple(bytes.fromhex(colour.removeprefix("#")))


def _about(drive: OneDrive) -> str:
    """Where it comes from, and how far off everyone is."""
    recordings = drive.recordings
    scene = recordings.scenes[0]
    lines = [
        f"# {scene.name}",
        f"Log {scene.log}, {', '.join(scene.conditions)}; data {data_label(recordings.manifest)}; track {drive.track}. "
        "Ways start at the true first pose; policies that learn were fitted on other drives.",
        "| row | ATE [m] |\n|---|---:|\n"
        + "\n".join(f"| {way.name} | {np.sqrt(np.mean(drive.error_m(way) ** 2)):.2f} |" for way in drive.ways),
    ]
    return "\n\n".join(lines) + "\n"
