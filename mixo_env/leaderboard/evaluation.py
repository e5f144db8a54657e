"""Playing policies through recorded scenes and measuring where the car ends up."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mixo_env.envs.replay import Replay
from mixo_env.experts.expert import State
from mixo_env.experts.monocular.config import MonocularConfig
from mixo_env.fusion import dead_reckon
from mixo_env.leaderboard.noise import NOISE_FLOOR, yaw_noise
from mixo_env.metrics.absolute import SceneAbsolute, absolute_errors_se2, scene_absolute
from mixo_env.metrics.pairs import PairRule, Pairs, find_pairs, path_length
from mixo_env.metrics.relative import RelativeSamples, relative_errors_se2
from mixo_env.metrics.tracks import LostTracks, count_lost_tracks
from mixo_env.policies.fitting import check
from mixo_env.policies.playing import play
from mixo_env.policies.policy import Policy
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.schema import VehicleConstants
from mixo_env.recordings.vehicles import travelled_m
from mixo_env.trajectory.planar import PlanarPoses

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Travel:
    """Estimated travel of all scenes of a recording, flat like its columns; row 0 of a scene holds NaN.

    Attributes:
        yaw_increment_rad, distance_m: ``(rows,)``.
        course_offset_rad: ``(rows,)`` direction of travel minus heading.
    """

    yaw_increment_rad: FloatArray
    distance_m: FloatArray
    course_offset_rad: FloatArray


def rollout(policy: Policy, recordings: Recordings, track: str, *, privileged: bool = False) -> Travel:
    """Play a fitted policy through every scene at once, step by step, feeding back its own fused yaw rate.

    Args:
        policy: prepared; what it observes are fresh arrays, which lead nowhere else.
        recordings: tested scenes.
        track: whose experts vote.
        privileged: show it the ``truth.*`` yaw rate of these recordings.

    Raises:
        PolicyError: when the policy was fitted for other voters, in another order, or on one of these drives.
    """
    check(policy, recordings, track)
    replay = Replay(recordings, track=track, experts=policy.experts, privileged=privileged)
    increments = np.full(recordings.offsets[-1], np.nan)
    row = recordings.offsets[:-1].copy()
    for active, *_ in play(policy, replay):
        row[active] += 1
        increments[row[active]] = replay.state["increment_rad"][active]
    return with_wheels(recordings, increments)


def with_wheels(recordings: Recordings, yaw_increment_rad: FloatArray) -> Travel:
    """Travel with the given yaw and the recorded wheel distance, with each vehicle's constants."""
    vehicles = recordings.manifest.vehicles
    constants = [vehicles.get(scene.vehicle, VehicleConstants()) for scene in recordings.scenes]
    rows = np.diff(recordings.offsets)
    course_offset = np.repeat([vehicle.course_offset_rad for vehicle in constants], rows)
    return Travel(yaw_increment_rad, travelled_m(recordings), course_offset)


def perfect_yaw(recordings: Recordings) -> Travel:
    """Privileged floor: true yaw, wheel distance. What is left is no fault of any yaw estimate."""
    return with_wheels(recordings, recordings["truth.yaw_increment_rad"])


def noisy_truth(recordings: Recordings) -> Travel:
    """Privileged floor: the true yaw seen through the estimated noise of the truth itself, wheel distance.

    An exact estimate would score about as much against poses of this noise; below it nothing is a win.
    """
    noise = yaw_noise(recordings).draw(recordings)
    return with_wheels(recordings, recordings["truth.yaw_increment_rad"] + np.diff(noise, prepend=0.0))


def perfect_yaw_and_distance(recordings: Recordings) -> Travel:
    """Privileged floor: true yaw and distance. What is left is the direction of travel: eq. 1 assumes the heading."""
    return replace(perfect_yaw(recordings), distance_m=recordings["truth.distance_m"])


FLOORS = {"PERFECT YAW": perfect_yaw, "PERFECT YAW + TRUE DISTANCE": perfect_yaw_and_distance, NOISE_FLOOR: noisy_truth}
"""Privileged rows that stand in every table; they choose no weights, so they are no policies."""


def poses(travel: Travel, start: PlanarPoses, offsets: NDArray[np.int64]) -> PlanarPoses:
    """Dead reckoning (eqs. 4 and 1) of every scene from its first true pose."""
    out = PlanarPoses(*(np.empty(offsets[-1]) for _ in range(3)))
    for first, stop in itertools.pairwise(offsets.tolist()):
        x, y, yaw = dead_reckon(
            travel.yaw_increment_rad[first + 1 : stop],
            travel.distance_m[first + 1 : stop],
            start=(float(start.x_m[first]), float(start.y_m[first]), float(start.yaw_rad[first])),
            course_offset_rad=float(travel.course_offset_rad[first]),
        )
        out.x_m[first:stop], out.y_m[first:stop], out.yaw_rad[first:stop] = x, y, yaw
    return out


@dataclass(frozen=True)
class Errors:
    """Everything measured about one travel on all scenes; scores are statistics of it.

    Attributes:
        absolute: RMSE of every scene.
        relative: samples of all scenes.
        squared_yaw_increment_deg2: ``(scenes,)`` sum over the steps.
        steps: ``(scenes,)`` their number.
    """

    absolute: SceneAbsolute
    relative: RelativeSamples
    squared_yaw_increment_deg2: FloatArray
    steps: NDArray[np.int64]


def scene_means(samples: RelativeSamples, scenes: int) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
    """Mean RTE [%] and [deg/m] of each scene ``(scenes,)``, NaN without a sample, and their number."""
    counts = np.bincount(samples.scene, minlength=scenes)
    sums = (
        np.bincount(samples.scene, weights=values, minlength=scenes)
        for values in (samples.translation_percent, samples.rotation_deg_per_m)
    )
    translation, rotation = (np.where(counts > 0, total / np.maximum(counts, 1), np.nan) for total in sums)
    return translation, rotation, counts


def mean_errors(runs: Sequence[Errors]) -> Errors:
    """The mean of each error over runs of several seeds: what a row reports, never its best run."""
    if len(runs) == 1:
        return runs[0]
    first = runs[0]

    def mean(values: Callable[[Errors], FloatArray]) -> FloatArray:
        return np.mean([values(run) for run in runs], axis=0)

    return Errors(
        absolute=SceneAbsolute(
            mean(lambda run: run.absolute.translation_m), mean(lambda run: run.absolute.rotation_deg)
        ),
        relative=replace(
            first.relative,
            translation_m=mean(lambda run: run.relative.translation_m),
            rotation_deg=mean(lambda run: run.relative.rotation_deg),
            translation_percent=mean(lambda run: run.relative.translation_percent),
            rotation_deg_per_m=mean(lambda run: run.relative.rotation_deg_per_m),
        ),
        squared_yaw_increment_deg2=mean(lambda run: run.squared_yaw_increment_deg2),
        steps=first.steps,
    )


class Truth:
    """The true way through every scene, and the pieces of path on which every travel is compared."""

    def __init__(self, recordings: Recordings, truth: str = "truth", rule: PairRule | None = None) -> None:
        """Prepare one of those of ``recordings``; ``rule`` chooses the pieces of path (default: headline's)."""
        self.offsets = recordings.offsets
        x, y, yaw = (recordings[f"{truth}.{name}"].astype(np.float64) for name in ("x_m", "y_m", "yaw_rad"))
        self.poses = PlanarPoses(x, y, yaw)
        self._rule = rule or PairRule()
        self._increments = np.diff(yaw, prepend=np.nan)
        self._increments[self.offsets[:-1]] = np.nan

    @cached_property
    def travelled_m(self) -> FloatArray:
        """``(rows,)`` length of the true path since the start of the scene."""
        return path_length(np.stack([self.poses.x_m, self.poses.y_m], axis=-1), self.offsets)

    @cached_property
    def pairs(self) -> Pairs:
        """Where every piece of path begins and ends."""
        return find_pairs(self.travelled_m, self._rule, self.offsets)

    def pieces(self) -> dict[float, tuple[int, int]]:
        """Length [m] -> number of pieces, and of scenes that have one."""
        scenes = {length: self.pairs.scene[self.pairs.length_m == length] for length in self.pairs.lengths_m}
        return {length: (len(scene), len(np.unique(scene))) for length, scene in scenes.items()}

    def measure(self, travel: Travel) -> Errors:
        """Errors of a travel that covers every scene, integrated from the true first poses, without alignment."""
        true, estimate = self.poses, poses(travel, self.poses, self.offsets)
        yaw_error = np.degrees(travel.yaw_increment_rad - self._increments)
        steps = np.diff(self.offsets) - 1
        return Errors(
            absolute=scene_absolute(absolute_errors_se2(true, estimate), self.offsets),
            relative=relative_errors_se2(true, estimate, self.pairs, end_length=self._rule.end_length),
            squared_yaw_increment_deg2=np.add.reduceat(np.nan_to_num(yaw_error) ** 2, self.offsets[:-1]),
            steps=steps,
        )


def lost_tracks(recordings: Recordings, name: str, *, instantly: bool = False) -> LostTracks | None:
    """Lost tracks behind a row of the leaderboard.

    A camera's, further or imported expert's own for its row, ``None`` for inertial experts and floors, which have no
    track to lose; for everything else the times when no camera was tracking (no imported expert, where there are no
    cameras).

    Args:
        recordings: all scenes.
        name: of the row.
        instantly: as if every camera tracked again with its first good pair of images.
    """
    manifest = recordings.manifest
    imported = (*manifest.imported, *recordings.further)
    if name in FLOORS or name in manifest.inertial or (instantly and (name in imported or not manifest.cameras)):
        return None
    cameras = manifest.cameras or manifest.imported
    tracking = instantly_tracking if instantly else _tracking
    if name in manifest.cameras or name in imported:
        state = recordings[f"{name}.state"]
        return count_lost_tracks(
            tracking(recordings, name),
            recordings.offsets,
            lost=state == State.LOST,
            observed=state != State.NO_IMAGE,
        )
    if not cameras:
        return None
    return count_lost_tracks(np.any([tracking(recordings, c) for c in cameras], axis=0), recordings.offsets)


def _tracking(recordings: Recordings, camera: str) -> NDArray[np.bool_]:
    return recordings[f"{camera}.state"] == State.TRACKING


def instantly_tracking(recordings: Recordings, camera: str) -> NDArray[np.bool_]:
    """``(rows,)`` where a camera would track with ``initial_pairs=1, initial_distance_m=0``: instant re-initialisation.

    No second run is needed: a good pair of images never leaves a camera LOST, so the states tell good pairs from bad
    ones, and the matches tell which of them could have begun a track.
    """
    state, matches = recordings[f"{camera}.state"], recordings[f"{camera}.matches"]
    settings = recordings.manifest.parameters.get("monocular", {})
    least = settings.get("initial_matches", MonocularConfig().initial_matches)
    row = np.arange(len(state))
    good = ((state == State.TRACKING) | (state == State.INITIALISING)) & (matches > 0)
    broken = ~good & (state != State.NO_IMAGE)
    broken[recordings.offsets[:-1]] = True  # a scene starts without a track
    begun, ended = (np.maximum.accumulate(np.where(at, row, -1)) for at in (good & (matches >= least), broken))
    return good & (begun > ended)
