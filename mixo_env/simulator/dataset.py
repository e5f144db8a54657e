"""Simulate a data set into a folder in nuScenes format, on several processes, continuing where it stopped.

A scene is finished when its rows lie in ``parts/``; the tables are written when all scenes asked for are finished, and
list the finished ones. So neither a half-written scene nor a half-finished data set can be taken for a whole one.
"""

from __future__ import annotations

import dataclasses
import io
import json
import threading
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mixo_env.errors import ConfigurationError, DatasetError, unknown
from mixo_env.files import write_bytes
from mixo_env.nuscenes.images import read_jpeg
from mixo_env.nuscenes.scene import ExactPoses
from mixo_env.nuscenes.writer import scene_tables, write_can_bus, write_json, write_tables
from mixo_env.simulator.config import CameraFault, SimulationConfig
from mixo_env.simulator.drive.scenario import LogPlan, ScenePlan, plan_logs
from mixo_env.simulator.drive.scenes import SimulatedScene, blank_sides, camera_fault, pictures, shots, simulate_scene
from mixo_env.simulator.drive.spoiling import Spoiler, encoded
from mixo_env.simulator.picture.faults import REDRAWN

if TYPE_CHECKING:
    from mixo_env.simulator.picture.render import Renderer

VERSION = "v1.0-mixo"
"""Name of the table folder."""

NOTE = "simulation.json"
"""What a folder holds."""

FORMAT = 5
"""Raised whenever equal configurations no longer give equal files."""

Progress = Callable[[int, int], None]


def simulate(
    config: SimulationConfig,
    out: Path,
    workers: int = 1,
    progress: Progress | None = None,
    only: Collection[str] = (),
    sound: Path | None = None,
) -> None:
    """Simulate a data set, or what is still missing of it.

    Args:
        config: what to simulate.
        out: folder to write; it is new, empty, or holds an interrupted run of the same configuration.
        workers: number of processes; the files do not depend on it. Each log is simulated by one of them.
        progress: called with the number of finished scenes and of those asked for whenever that changes.
        only: names of the scenes to do now; empty: all. A scene is the same with or without the others, and a later
            run adds to the folder.
        sound: finished folder of the same drives without the fault. Its pictures are taken instead of drawn anew, but
            those of a knocked camera; the files are the same.

    Raises:
        ConfigurationError: the folder holds something else, ``workers`` is not positive, a scene is unknown, or
            ``sound`` holds other drives.
        OutputError: a file cannot be written (disk full, no permission); a rerun continues.
    """
    if workers < 1:
        raise ConfigurationError(f"workers must be at least 1, got {workers}")
    logs = plan_logs(config)
    everything = [scene for log in logs for scene in log.scenes]
    for name in only:
        if name not in {scene.name for scene in everything}:
            raise ConfigurationError(unknown("scene", name, [scene.name for scene in everything]))
    out = out.absolute()
    _claim(config, out)
    if sound is not None:
        _check_sound(config, sound)
    asked = [scene for scene in everything if not only or scene.name in only]
    unfinished = {scene.name for scene in asked if not _part(out, scene).exists()}
    work = [(log, plans) for log in logs if (plans := [scene for scene in log.scenes if scene.name in unfinished])]
    with _reported(out, asked, progress):
        if workers == 1 or len(work) <= 1:
            for log, plans in work:
                _simulate_log(config, log, plans, out, sound)
        else:
            from joblib import Parallel, delayed

            Parallel(n_jobs=min(workers, len(work)))(
                delayed(_simulate_log)(config, log, plans, out, sound) for log, plans in work
            )
    finished = (_part(out, scene) for scene in everything)
    write_tables(out, VERSION, (_read(part) for part in finished if part.exists()))


def _claim(config: SimulationConfig, out: Path) -> None:
    """Make the folder ours, or make sure that it is."""
    note, mine = out / NOTE, _note(config)
    if not note.exists():
        if out.exists() and (not out.is_dir() or any(out.iterdir())):
            raise ConfigurationError(f"{out} is not an empty folder: choose a new one")
        write_json(note, mine)
        return
    found = _read(note)
    if found != mine:
        names = ", ".join(name for name in {**found, **mine} if found.get(name) != mine.get(name))
        raise ConfigurationError(
            f"{out} holds a simulation with another configuration (different: {names}): choose another folder"
        )


def _note(config: SimulationConfig) -> dict[str, Any]:
    """What a folder tells of itself."""
    mine = {"format": FORMAT, **json.loads(json.dumps(dataclasses.asdict(config)))}
    if config.fault.kind == "none":
        del mine["fault"]  # a sound data set says nothing of faults
    else:
        plans = [plan for log in plan_logs(config) for plan in log.scenes]
        mine["faults"] = {
            plan.name: {"begin_us": plan.start_us, **fault.note()}
            for plan in plans
            if (fault := camera_fault(config, plan))
        }
    return mine


def _check_sound(config: SimulationConfig, sound: Path) -> None:
    """Make sure that ``sound`` holds the drives of ``config`` without its fault, to the end."""
    plans = [plan for log in plan_logs(config) for plan in log.scenes]
    same = (sound / NOTE).exists() and _read(sound / NOTE) == _note(dataclasses.replace(config, fault=CameraFault()))
    if not same or not all(_part(sound, plan).exists() for plan in plans):
        raise ConfigurationError(f"{sound} does not hold these drives with sound cameras: simulate them there first")


def _read(path: Path) -> dict[str, Any]:
    """A file that an earlier run has written."""
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise DatasetError(f"cannot read {path}: {error}; delete it and run again") from error


def _part(out: Path, scene: ScenePlan) -> Path:
    return out / "parts" / f"{scene.name}.json"


def _simulate_log(
    config: SimulationConfig, log: LogPlan, plans: Sequence[ScenePlan], out: Path, sound: Path | None
) -> None:
    """Some scenes of one log; the city is built once, and as all scenes of the log need it."""
    import cv2

    cv2.setNumThreads(1)
    drawn = config.images and (sound is None or config.fault.kind in REDRAWN)
    renderer = _renderer(config, log) if drawn else None
    for plan in plans:
        _simulate_scene(config, (log, plan), out, renderer, sound)


def _renderer(config: SimulationConfig, log: LogPlan) -> Renderer:
    """The log's city in its weather."""
    from mixo_env.simulator.city.land import land_of
    from mixo_env.simulator.city.world import CityPlan, build_world
    from mixo_env.simulator.picture.render import Renderer

    walls: dict[str, Any] = {"grain": 0.4, "blank_walls": 0.5} if log.low_texture else {}
    land, blank = land_of(log.world_seed), blank_sides(config, log)
    world = build_world(log.world_seed, CityPlan(blank_sides=blank, low_sun=log.low_sun, land=land, **walls))
    return Renderer(world, "low sun" if log.low_sun else log.weather)


def _simulate_scene(
    config: SimulationConfig,
    which: tuple[LogPlan, ScenePlan],
    out: Path,
    renderer: Renderer | None,
    sound: Path | None,
) -> None:
    """Write one scene; its part comes last."""
    log, plan = which
    simulated = simulate_scene(config, log, plan, out)
    scene, fault = simulated.scene, camera_fault(config, plan)
    if config.images:
        spoiler = None if fault is None else Spoiler(fault, shots(log, plan, simulated, fault))
        redrawn = (fault.camera,) if sound is not None and fault is not None else ()
        if sound is not None:
            for path in _taken_over(simulated, redrawn if renderer else ()):
                jpeg = read_jpeg(sound / path.relative_to(out))
                write_bytes(path, spoiler.spoilt(path, jpeg) if spoiler else jpeg)
        if renderer is not None:
            for path, image in pictures(config, log, plan, simulated, renderer, redrawn):
                jpeg = encoded(image)
                write_bytes(path, spoiler.spoilt(path, jpeg) if spoiler else jpeg)
    write_can_bus(out, scene.name, simulated.messages)
    if scene.exact is not None:
        write_bytes(out / "exact" / f"{scene.name}.npz", _packed(scene.exact))
    write_json(_part(out, plan), scene_tables(out, scene, simulated.times.sample_us))


def _taken_over(simulated: SimulatedScene, redrawn: Sequence[str]) -> Iterator[Path]:
    """Pictures that are not drawn anew, camera by camera in time order."""
    for channel, reel in simulated.scene.cameras.items():
        if channel not in redrawn:
            yield from reel.image_paths


def _packed(exact: ExactPoses) -> bytes:
    """The exact poses as a NumPy archive."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, timestamp_us=exact.timestamp_us, x_m=exact.x_m, y_m=exact.y_m, yaw_rad=exact.yaw_rad)
    return buffer.getvalue()


@contextmanager
def _reported(out: Path, scenes: list[ScenePlan], progress: Progress | None) -> Iterator[None]:
    """Call ``progress`` while other processes finish scenes: their parts are the only thing all of them share."""
    if progress is None:
        yield
        return
    stop = threading.Event()

    def finished() -> int:
        return sum(_part(out, scene).exists() for scene in scenes)

    def watch() -> None:
        last = -1
        while True:
            done = stop.wait(0.5)
            count = finished()
            if count != last:
                progress(count, len(scenes))
                last = count
            if done:
                return

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
