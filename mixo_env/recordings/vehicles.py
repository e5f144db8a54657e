"""Constants of each vehicle, fitted on recordings: how late its poses are, how far its wheels roll, where it heads.

On real data they leave an error of 0.3 to 0.7 m in scenes of 100 m even with perfect yaw. They must come from training
folds: the poses of a scene that is scored may check them, never correct them. The pose lag comes first, because all
others are read off poses from which it is removed.
"""

from __future__ import annotations

import logging
from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import RecordingError
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.pose_lag import lag_corrected
from mixo_env.recordings.pose_lag_fit import fit_pose_lags
from mixo_env.recordings.schema import SPLITS, VehicleConstants

logger = logging.getLogger(__name__)

LEAST_DISTANCE_M = 50.0
"""A vehicle that drove less in the training scenes gets the constants of all of them together."""

LEAST_GAIN = 1.0
"""Sum of squared speed changes [m^2/s^2] below which a latency is not worth telling: it shrinks towards 0."""


def fit_vehicle_constants(training: Recordings, vehicles: Iterable[str]) -> dict[str, VehicleConstants]:
    """Pose lag, wheel scale, latency and course offset by vehicle.

    A distance that is tau late lacks what the speed gained meanwhile, tau (v_k - v_{k-1}). Scale and latency are fitted
    together: the scale so that the sum of all distances is true, the latency so that what is then missing in a step
    does not go with the gain in speed. The course offset turns the recorded chords, laid along the true mean heading of
    each step, onto the true ones with the least squared distance. "True" are the poses without their lag.

    Args:
        training: recordings of the training folds.
        vehicles: names wanted; one that drives less than 50 m in ``training`` gets the constants of all vehicles
            together, but for the pose lag, which is its own or 0.

    Raises:
        RecordingError: the training scenes do not move.
    """
    vehicles = tuple(dict.fromkeys(vehicles))
    lags_s = fit_pose_lags(training, (*vehicles, *(scene.vehicle for scene in training.scenes)))
    lagging = {vehicle: VehicleConstants(pose_lag_s=lag_s) for vehicle, lag_s in lags_s.items()}
    training = lag_corrected(training.replace(replace(training.manifest, vehicles=lagging)))
    first = np.zeros(len(training["step"]), dtype=np.bool_)
    first[training.offsets[:-1]] = True
    rows = np.flatnonzero(~first)
    motion = np.diff(training["truth.x_m"] + 1j * training["truth.y_m"])[rows - 1]
    middle = training["truth.yaw_rad"][rows] - 0.5 * training["truth.yaw_increment_rad"][rows]
    in_car = motion * np.exp(-1j * middle)
    distance_m = training["distance_m"][rows].astype(np.float64)
    gained_mps = speed_gain_mps(training)[rows]
    true_m = training["truth.distance_m"][rows]
    owner = np.repeat([scene.vehicle for scene in training.scenes], np.diff(training.offsets))[rows]

    everyone = np.ones(len(rows), dtype=np.bool_)
    if true_m.sum() < LEAST_DISTANCE_M:
        raise RecordingError(
            f"the training scenes drive {true_m.sum():.1f} m; vehicle constants need {LEAST_DISTANCE_M:g}: add scenes"
        )

    def fit(name: str) -> VehicleConstants:
        own = owner == name
        of = own if true_m[own].sum() >= LEAST_DISTANCE_M else everyone
        recorded, gained, true = distance_m[of], gained_mps[of], true_m[of]
        # Sums, not scalar products: those of long vectors depend in their last bits on the number of threads.
        crossed, squared, wanted = (float((gained * other).sum()) for other in (recorded, gained, true))
        scale, latency_s = np.linalg.solve(
            [[recorded.sum(), gained.sum()], [crossed, max(squared, LEAST_GAIN)]],
            [true.sum(), wanted],
        )
        return VehicleConstants(
            wheel_scale=float(scale),
            course_offset_rad=float(np.angle(np.sum(recorded * in_car[of]))),
            can_latency_s=float(latency_s),
            pose_lag_s=lags_s[name],
        )

    return {name: fit(name) for name in vehicles}


def speed_gain_mps(recordings: Recordings) -> NDArray[np.float64]:
    """``(rows,)`` change of the recorded speed over every step; 0 in row 0 of a scene."""
    gain = np.diff(recordings["speed_mps"].astype(np.float64), prepend=0.0)
    gain[recordings.offsets[:-1]] = 0.0
    return gain


def travelled_m(recordings: Recordings) -> NDArray[np.float64]:
    """``(rows,)`` recorded distances, corrected by scale and latency of each scene's vehicle; NaN in row 0."""
    constants = [recordings.manifest.vehicles.get(scene.vehicle, VehicleConstants()) for scene in recordings.scenes]
    scale, latency_s = np.repeat(
        [(vehicle.wheel_scale, vehicle.can_latency_s) for vehicle in constants], np.diff(recordings.offsets), axis=0
    ).T
    return recordings["distance_m"] * scale + latency_s * speed_gain_mps(recordings)


def training_constants(recordings: Recordings) -> dict[str, VehicleConstants]:
    """Constants for all vehicles of a recording, fitted on its split "train": what its manifest holds."""
    return _fitted_or_nominal(recordings, SPLITS["train"], [scene.vehicle for scene in recordings.scenes])


def with_training_constants(recordings: Recordings, folds: Collection[int]) -> Recordings:
    """The recordings with constants fitted on ``folds`` instead of those in the manifest."""
    constants = _fitted_or_nominal(recordings, folds, [scene.vehicle for scene in recordings.scenes])
    return recordings.replace(replace(recordings.manifest, vehicles=constants))


def with_held_out_constants(recordings: Recordings) -> Recordings:
    """The recordings as cross-validation must see them: no scene's constants are fitted on its own fold.

    Every vehicle is entered once per fold it drives in, as ``"<vehicle> in fold <fold>"``, with constants from the
    other folds (a night scene, in fold -1: from all folds). With fewer than two folds there is nothing to fit them on
    that is not scored: they stay nominal, but for the pose lag, which comes from the vehicle's other logs (it is
    entered as ``"<vehicle> but <log>"``). A vehicle that drives nowhere else has lag 0, and the log says so.
    """
    folds = sorted({scene.fold for scene in recordings.scenes if scene.fold >= 0})
    if len(folds) < 2:
        return _with_lags_of_other_logs(recordings)
    constants: dict[str, VehicleConstants] = {}
    for fold in {scene.fold for scene in recordings.scenes}:
        names = [scene.vehicle for scene in recordings.scenes if scene.fold == fold]
        fitted = _fitted_or_nominal(recordings, [other for other in folds if other != fold], names)
        constants |= {f"{name} in fold {fold}": values for name, values in fitted.items()}
    scenes = tuple(replace(scene, vehicle=f"{scene.vehicle} in fold {scene.fold}") for scene in recordings.scenes)
    manifest = replace(recordings.manifest, scenes=scenes, vehicles=constants)
    return recordings.replace(manifest)


def _with_lags_of_other_logs(recordings: Recordings) -> Recordings:
    constants: dict[str, VehicleConstants] = {}
    for vehicle, log in dict.fromkeys((scene.vehicle, scene.log) for scene in recordings.scenes):
        others = [scene.name for scene in recordings.scenes if scene.vehicle == vehicle and scene.log != log]
        lag_s = fit_pose_lags(recordings.select(scenes=others), [vehicle])[vehicle] if others else 0.0
        if not others:
            logger.info("pose lag of vehicle %s stays 0: it drives in no other log than %s", vehicle, log)
        constants[f"{vehicle} but {log}"] = VehicleConstants(pose_lag_s=lag_s)
    scenes = tuple(replace(scene, vehicle=f"{scene.vehicle} but {scene.log}") for scene in recordings.scenes)
    return recordings.replace(replace(recordings.manifest, scenes=scenes, vehicles=constants))


def _fitted_or_nominal(
    recordings: Recordings, folds: Collection[int], vehicles: Sequence[str]
) -> dict[str, VehicleConstants]:
    """Constants fitted on ``folds``; nominal ones where those hold no scene or hardly move."""
    if any(scene.fold in folds for scene in recordings.scenes):
        try:
            return fit_vehicle_constants(recordings.select(folds=tuple(folds)), vehicles)
        except RecordingError as error:
            logger.info("nominal vehicle constants: %s", error)
    return dict.fromkeys(vehicles, VehicleConstants())
