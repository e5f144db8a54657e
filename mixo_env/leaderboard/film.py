"""A film of one policy on one drive: the pictures of ``render_mode="rgb_array"``, one a step, as MP4."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mixo_env.envs import rendering
from mixo_env.envs.images import SceneImages
from mixo_env.envs.odometry import MixoOdometryEnv
from mixo_env.envs.replay import Replay
from mixo_env.errors import ConfigurationError, OutputError
from mixo_env.files import write_bytes
from mixo_env.leaderboard.one_drive import protocol_of
from mixo_env.policies.outside import Outside
from mixo_env.policies.playing import play
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.truths import with_truth
from mixo_env.recordings.variants import as_variant

CODEC = "vp09"
"""VP9 in MP4: what browsers play, of the codecs that OpenCV's wheels write."""

FRAMES_PER_S: int = MixoOdometryEnv.metadata["render_fps"]


@dataclass
class Stage:
    """A policy that is played without an environment, as it is drawn (implements ``Scenery``)."""

    recordings: Recordings
    replay: Replay
    images: SceneImages | None
    weights: NDArray[np.float64]


def frames(
    recordings: Recordings,
    scene: str,
    track: str,
    policy: Outside,
    *,
    images: Path | None = None,
    seed: int = 0,
) -> Iterator[rendering.Image]:
    """Pictures ``(540, 960, 3)`` RGB of one drive, before the first step and after every one.

    Args:
        recordings: all scenes; a policy that learns is fitted on the folds that do not hold this one.
        scene: its name.
        track: who votes.
        policy: row of the leaderboard, or from outside.
        images: the nuScenes folder that was recorded; ``None``: match counts stand in for images.
        seed: of a learned policy.

    Raises:
        ConfigurationError: for an unknown scene or track, or a floor, which weighs nobody.
        PolicyError: when the policy does not fit the recordings.
    """
    protocol = protocol_of(recordings, scene, track, [policy], seed)
    run = protocol.run(policy.name, track)
    if not run.policies:
        raise ConfigurationError(f"{policy.name} is a floor: it weighs no experts, so choose a policy")
    fitted = next(iter(run.policies.values()))
    alone = protocol.recordings.select(scenes=[scene])
    shown = as_variant(with_truth(alone, protocol.truths[0]), policy.name)
    replay = Replay(shown, track=track, experts=fitted.experts, privileged=run.privileged)
    pictures = SceneImages(shown, images, replay.cameras) if images else None
    stage = Stage(shown, replay, pictures, np.zeros((1, len(replay.experts))))
    replay.reset(np.zeros(1, np.int64))
    yield _titled(stage, policy.name, track)
    for _, _, weights in play(fitted, replay):
        stage.weights = np.asarray(weights, np.float64)
        yield _titled(stage, policy.name, track)


def _titled(stage: Stage, policy: str, track: str) -> rendering.Image:
    picture = rendering.draw(stage, 0)
    left, top, _, _ = rendering.MAP
    rendering.write(picture, f"policy {policy}, track {track}", (left + 12, top + 62))
    return picture


def write_film(path: Path, pictures: Iterator[rendering.Image], progress: Callable[[int], None]) -> int:
    """Write a film at once or not at all, and say how many pictures it has.

    Args:
        path: file to write.
        pictures: of one size.
        progress: told how many are done.

    Raises:
        OutputError: when it cannot be written, or this OpenCV cannot encode it.
    """
    import cv2

    first = next(pictures)
    height, width = first.shape[:2]
    with tempfile.TemporaryDirectory(prefix="mixo-film-") as folder:
        part = Path(folder) / "film.mp4"  # OpenCV tells the container from the suffix
        writer = cv2.VideoWriter(str(part), cv2.VideoWriter.fourcc(*CODEC), FRAMES_PER_S, (width, height))
        if not writer.isOpened():
            raise OutputError(f"cannot write {path}: this OpenCV has no encoder {CODEC}: install its official wheel")
        writer.write(first[:, :, ::-1])
        count = 1
        for picture in pictures:
            writer.write(picture[:, :, ::-1])
            count += 1
            progress(count)
        writer.release()
        write_bytes(path, part.read_bytes())
    return count
