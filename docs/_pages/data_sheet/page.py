"""docs/mixocity.md: a function of the recordings, of what was measured in the folder, and of what is real."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from docs._pages.data_sheet import comparison, prose
from docs._pages.data_sheet.comparison import Differences, number
from docs._pages.data_sheet.motion import motion_samples, motion_statistics, recorded_intervals, recorded_paths
from docs._pages.data_sheet.outcomes import (
    PAPER_BEST_FRONT,
    PAPER_BEST_OTHERS,
    PAPER_LOST,
    camera_lost_tracks,
    exact_step_errors,
    moving_steps,
    own_time_errors,
    tracking_share,
    turning_steps,
    yaw_errors,
)
from docs._pages.data_sheet.shares_section import shares_section
from mixo_env.errors import ConfigurationError
from mixo_env.leaderboard.firing_order import best_shares
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.folds import OUT_OF_DISTRIBUTION
from mixo_env.recordings.pose_lag import as_written, lag_corrected
from mixo_env.tables import Column, Table

Stored = Mapping[str, Any]

FIGURES = "figures/mixocity"
"""Where the pictures are, seen from the page."""


def page(recordings: Recordings, measured: Stored, real: Stored, study: Stored | None) -> str:
    """The whole sheet.

    Args:
        recordings: the bundled ones, or others recorded in the same folder.
        measured: :func:`docs._pages.data_sheet.measured.measure`.
        real: :mod:`docs._pages.data_sheet.real`.
        study: result of :mod:`experiments.situation_shares`, if there is one; one of other recordings does not count.

    Raises:
        ConfigurationError: if the recordings are of other scenes than the folder that was measured.
    """
    names = [scene.name for scene in recordings.scenes]
    if list(measured["situations"]) != names:
        raise ConfigurationError(
            f"the recordings hold {len(names)} scenes, the folder that was measured {len(measured['situations'])}: "
            "give the recordings of that folder, or run again with --images"
        )
    if study is not None and study["values_hashes"] != [scene.values_hash for scene in recordings.scenes]:
        study = None
    differences = Differences()
    beside = _beside_real(recordings, measured, real, differences)  # finds the differences that are listed later
    sections = [
        prose.HEAD.format(data=recordings.manifest.data_version),
        _how_made(recordings, measured),
        _sights(measured),
        beside,
        _differences(differences),
        _outcomes(recordings, measured),
        shares_section(study),
    ]
    return "\n\n".join(section.strip() for section in sections) + "\n"


def table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table without a caption."""
    return Table("", tuple(Column(heading) for heading in headings), rows).markdown().strip()


def scored(recordings: Recordings) -> Recordings:
    """The scenes inside the folds: night is out of distribution, and the paper left it out as well."""
    folds = sorted({scene.fold for scene in recordings.scenes if scene.fold != OUT_OF_DISTRIBUTION})
    return recordings.select(folds=folds) if folds else recordings


def _how_made(recordings: Recordings, measured: Stored) -> str:
    configuration = dict(measured["configuration"])
    situations = configuration.pop("situations")
    staged = Counter(measured["situations"].values())
    software = ", ".join(f"{name} {version}" for name, version in measured["software"].items())
    shares = [
        [name.replace("_", " "), f"{share:g}", str(staged.get(name, 0))] for name, share in situations.items()
    ] + [["ordinary", f"{1 - sum(situations.values()):.2f}", str(staged.get("ordinary", 0))]]
    plain = "; ".join(
        f"{name} {', '.join(map(str, value)) if isinstance(value, list | tuple) else value}"
        for name, value in configuration.items()
    )
    return "\n\n".join(
        [
            prose.HOW_MADE.strip(),
            f"Configuration: {plain}. Software: {software}.",
            "Situations are dealt over the scenes, at most one each:",
            table(["situation", "share asked for", "scenes"], shares),
            prose.LOGS,
            _logs(recordings, measured),
            prose.EFFECTS.strip(),
        ]
    )


def _logs(recordings: Recordings, measured: Stored) -> str:
    fold_of = {scene.log: scene.fold for scene in recordings.scenes}
    rows = []
    for log in measured["logs"]:
        if log["log"] not in fold_of:
            continue
        scenes = [name for name in log["scenes"] if name in measured["situations"]]
        staged = [measured["situations"][name].replace("_", " ") for name in scenes]
        fold = fold_of[log["log"]]
        rows.append(
            [
                log["log"],
                f"{scenes[0][-4:]} to {scenes[-1][-4:]}" if len(scenes) > 1 else scenes[0][-4:],
                "ood" if fold == OUT_OF_DISTRIBUTION else str(fold),
                log["weather"]
                + (", low sun" if log.get("low_sun") else "")
                + (", low texture" if log["low_texture"] else ""),
                ", ".join(name for name in staged if name != "ordinary") or "-",
                number(log["wheel_radius_m"], 4),
                number(log["course_offset_deg"], 2),
                number(1000.0 * log["localisation_lag_s"], 0),
                number(log["imu_bias_degps"], 3),
                number(log["monitor_bias_degps"], 2),
                number(log["production_gyro_bias_degps"], 2),
                str(log["world_seed"]),
            ]
        )
    headings = ["log", "scenes", "fold", "weather", "staged", "wheel [m]", "course [deg]", "lag [ms]"]
    headings += ["ms_imu [deg/s]", "monitor [deg/s]", "production gyro [deg/s]", "world seed"]
    return table(headings, rows)


def _sights(measured: Stored) -> str:
    samples = dict(measured["samples"])
    strip, movers = samples.pop("cameras.jpg", None), samples.pop("movers.jpg", None)
    lines = ["## What it looks like"]
    if strip:
        lines.append(f"![All six cameras at one instant]({FIGURES}/cameras.jpg)")
        lines.append(f"The six cameras of the rig at one instant ({strip['source']}); the recordings use four of them.")
    cells = [
        f"![{sample['title']}]({FIGURES}/{file})<br>**{sample['title']}** ({sample['source']})"
        for file, sample in samples.items()
    ]
    cells += [""] * (-len(cells) % 3)
    rows = ["| " + " | ".join(cells[k : k + 3]) + " |" for k in range(0, len(cells), 3)]
    lines.append(prose.SAMPLES)
    lines.append("\n".join(["| | | |", "|---|---|---|", *rows]))
    if movers:
        lines.append(f"![Matches on moving vehicles]({FIGURES}/movers.jpg)")
        lines.append(f"**{movers['title']}** ({movers['source']}); see [movers](#matches-on-moving-vehicles).")
    return "\n\n".join(lines)


def _beside_real(recordings: Recordings, measured: Stored, real: Stored, differences: Differences) -> str:
    paths = recorded_paths(recordings)
    motion, intervals = motion_statistics(paths), recorded_intervals(recordings)
    return "\n\n".join(
        part.strip()
        for part in (
            prose.BESIDE.format(relative=100 * comparison.RELATIVE, widened=100 * comparison.WIDENED),
            prose.PICTURES,
            comparison.pictures_table(measured["pictures"], real["pictures"], differences),
            prose.PAIRS,
            comparison.pairs_table(measured["pairs"], real["pairs"], differences),
            prose.MOTION.format(frames=int(sum(len(path.x_m) for path in paths)), scenes=len(paths)),
            comparison.motion_table(motion, real["motion"], differences),
            comparison.distances_table(motion_samples(paths), real["motion"], differences),
            comparison.shares_table(motion["shares"], real["motion"]["shares"], differences),
            f"![Distributions of the motion]({FIGURES}/motion.png)",
            prose.INTERVALS,
            comparison.intervals_table(intervals, real["intervals"]),
            prose.SENSORS,
            comparison.sensors_table(measured["sensors"], real["sensors"], differences),
        )
    )


def _differences(differences: Differences) -> str:
    found = "\n".join(f"* {difference}" for difference in differences.found) or "* none"
    return "\n\n".join(
        [
            "## Known differences",
            f"Of {differences.checked} figures that were judged, {len(differences.found)} lie outside their bands:",
            found,
            prose.DIFFERENCES,
        ]
    )


def _outcomes(recordings: Recordings, measured: Stored) -> str:
    inside = lag_corrected(scored(recordings))
    lost_rows = []
    for row in (*inside.manifest.cameras, *inside.manifest.variants):
        lost, instant = (camera_lost_tracks(inside, row, instantly=instantly) for instantly in (False, True))
        paper = PAPER_LOST.get(row)
        tracking = f"{100 * tracking_share(inside, row):.1f}"
        lost_rows.append(
            [
                row,
                f"{paper[0]:.2f} ± {paper[1]:.2f}" if paper else "-",
                f"{lost.mean:.2f} ± {lost.std:.2f}",
                f"{instant.mean:.2f} ± {instant.std:.2f}",
                tracking,
            ]
        )
    return "\n\n".join(
        part.strip()
        for part in (
            prose.OUTCOMES.format(scenes=len(inside)),
            prose.LOST,
            table(["camera", "paper", "here", "here, instant re-initialisation", "tracking [%]"], lost_rows),
            _lost_in_all(inside),
            prose.YAW.format(lags=_lags(inside)),
            _yaw(inside),
            prose.BEST,
            _best(inside),
            prose.BY_SITUATION,
            _by_situation(inside, measured),
            prose.MOVERS,
            _movers(measured),
        )
    )


def _lags(recordings: Recordings) -> str:
    """The lag that was removed, by vehicle."""
    vehicles = sorted(recordings.manifest.vehicles.items())
    return ", ".join(f"{name} {number(1e3 * constants.pose_lag_s, 1)} ms" for name, constants in vehicles)


def _lost_in_all(recordings: Recordings) -> str:
    cameras = [camera for camera in recordings.manifest.cameras if camera in PAPER_LOST]
    here = sum(camera_lost_tracks(recordings, camera).mean for camera in cameras)
    paper = sum(PAPER_LOST[camera][0] for camera in cameras)
    easier = "less" if here < paper else "more"
    return (
        f"All {len(cameras)} cameras together lose {here:.2f} tracks per scene here and {paper:.2f} in the paper: this "
        f"city, seen by these experts, is {easier} hard on single cameras than nuScenes was on the paper's."
    )


def _yaw(recordings: Recordings) -> str:
    cameras = recordings.manifest.cameras
    groups: dict[str, tuple[str, ...]] = {camera: (camera,) for camera in cameras}
    groups["both side cameras"] = tuple(camera for camera in cameras if camera.endswith(("_LEFT", "_RIGHT")))
    rows = []
    for name, group in groups.items():
        errors = yaw_errors(recordings, group)
        rows.append(
            [
                name,
                f"{100 * np.mean([tracking_share(recordings, camera) for camera in group]):.1f}",
                number(errors.median_deg, 4),
                number(errors.rms_deg, 4),
                number(errors.gain, 4),
                *(number(float(np.quantile(errors.accumulated_deg, q)), 2) for q in (0.5, 0.9)),
                str(len(errors.accumulated_deg)),
            ]
        )
    headings = ["camera", "tracking [%]", "median [deg]", "RMS [deg]", "gain in turns"]
    return table([*headings, "accumulated [deg]", "90 %", "camera-scenes"], rows)


def _best(recordings: Recordings) -> str:
    moving, turning = moving_steps(recordings), turning_steps(recordings)
    own, exact = own_time_errors(recordings), exact_step_errors(recordings)
    shares = [
        best_shares(own, moving),
        best_shares(own, moving & turning),
        best_shares(own, moving & ~turning),
        best_shares(own_time_errors(as_written(recordings)), moving),
        best_shares(exact, moving),
    ]
    rows = []
    for j, camera in enumerate(recordings.manifest.cameras):
        front = camera == "CAM_FRONT"
        paper = f"{100 * (PAPER_BEST_FRONT if front else PAPER_BEST_OTHERS):.0f}" + (
            "" if front else " (mean of three)"
        )
        rows.append([camera, paper, *(number(100.0 * share[j], 1) for share in shares)])
    headings = ["locally best [%]", "paper", "moving steps", "of these, turning", "not turning"]
    return table([*headings, "moving, poses as written", "moving, exact truth"], rows)


def _by_situation(recordings: Recordings, measured: Stored) -> str:
    situations = [measured["situations"][scene.name] for scene in recordings.scenes]
    cameras = recordings.manifest.cameras
    counts = np.stack([camera_lost_tracks(recordings, camera).counts for camera in cameras], axis=1)
    own, moving = own_time_errors(recordings), moving_steps(recordings)
    scene_of_row = np.repeat(np.arange(len(situations)), np.diff(recordings.offsets))
    rows = []
    for situation in sorted(set(situations), key=lambda name: (name != "ordinary", name)):
        here = np.array([name == situation for name in situations])
        best = best_shares(own, moving & here[scene_of_row])
        rows.append(
            [
                situation.replace("_", " "),
                str(here.sum()),
                *(f"{lost:.2f}" for lost in counts[here].mean(axis=0)),
                *(number(100.0 * share, 0) for share in best),
            ]
        )
    short = [camera.removeprefix("CAM_") for camera in cameras]
    return table(["situation", "scenes", *(f"lost {c}" for c in short), *(f"best {c} [%]" for c in short)], rows)


def _movers(measured: Stored) -> str:
    rows = []
    for camera, covered in measured["covered"].items():
        movers = measured["movers"].get(camera, {})
        percents = ("covered", "matches", "inliers", "captured_inliers", "odometry", "captured_odometry")
        rows.append(
            [
                camera,
                number(100.0 * covered, 1),
                f"{movers.get('pairs', 0):.0f}",
                *(number(100.0 * movers.get(key, np.nan), 1) for key in percents),
            ]
        )
    headings = ["camera", "covered, all images [%]", "pairs", "covered [%]", "matches on movers [%]"]
    headings += ["RANSAC inliers on movers [%]", "pairs captured [%]"]
    headings += ["odometry's inliers on movers [%]", "pairs captured, odometry [%]"]
    return table(headings, rows)
