"""What stands below the tables: conventions, comparisons fixed beforehand, weights, the cost of the firing order."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mixo_env.experts.families import is_family_expert
from mixo_env.leaderboard.board import RANKING_LOGS, Leaderboard, Standings
from mixo_env.leaderboard.checks import silent_experts
from mixo_env.leaderboard.comparisons import CONFIRMATORY, Comparison, Comparisons
from mixo_env.leaderboard.firing_order import FiringOrder, Told, firing_order
from mixo_env.leaderboard.noise import Source, yaw_noise
from mixo_env.leaderboard.rows import Row
from mixo_env.metrics.tracks import LostTracks
from mixo_env.recordings.presets import data_label
from mixo_env.recordings.schema import TRACKS, TRUE_DISTANCE, UNEQUAL, Manifest

TRUTH_NAMES = {
    "exact": "the simulator's noise-free poses",
    "truth": "the poses without their lag",
    "written": "the poses as written",
}
"""Where no pose has a lag, ``truth`` is what was written, and there is no column of that name."""

TOLD_FROM: dict[Source, str] = {
    "cameras and gyro": "what cameras and gyro alike deny; errors the poses share with either stay unseen",
    "gyro": "white noise only, a weak lower bound: no cameras, or too little driving, to tell more",
    "nothing": "not known: no INERTIAL",
}
"""How far the noise floor of the truth can be believed."""

LEGEND = (
    "Lower is better. RTE: pooled relative error, with its 95 % interval; letters: rows that cannot be told apart "
    "share one; - LINEAR, - MIXO: paired difference in RTE deg/m and its Holm-corrected p; ATE: mean over scenes; "
    "lost: tracks lost per scene, mean ± standard deviation (a fused method loses track when no camera tracks; -: no "
    "track to lose); yaw: RMSE of one step's increment; > 0.5 m: share of scenes with a larger ATE. † reads ground "
    "truth or the future; * has no vote in this track."
)


def conventions(board: Leaderboard) -> list[str]:
    """Everything needed to read the numbers, one sentence a line."""
    protocol, recordings = board.protocol, board.recordings
    trial = protocol.trial
    pieces = board.truths[board.headline].pieces().items()
    samples = ", ".join(f"{length:g} m {count} ({scenes})" for length, (count, scenes) in pieces)
    size = f"{count_of(len(recordings), 'scene')} of {count_of(board.logs, 'log')}"
    intervals = f"Intervals: bootstrap over {board.logs} logs." if board.logs > 1 else "Intervals: none, one log."
    clock = ", from key frame to key frame (2 Hz)" if trial.ground_truth == "keyframes" else ""
    seeds = f" and {trial.seeds} seeds of learned policies (mean of their errors)" if trial.seeds > 1 else ""
    lines = [
        f"Data {data_label(recordings.manifest)}: {size}{clock}"
        + (f", {count_of(protocol.left_out, 'scene')} outside the folds left out" if protocol.left_out else "")
        + f"; seed {trial.seed}{seeds}.",
        f"Alignment: none, the first pose is the truth's. {_truths(board)} A row that reads the truth chooses by the "
        "one that scores it.",
        f"RTE: mean over all pieces of path, starts 1 m apart; pieces (scenes) per length: {samples}.",
        f"{intervals} {_folds(board)}",
    ]
    lines += _of_agents(board)
    lines += _of_imports(board)
    if board.headline != "exact" and not recordings.manifest.inertial:
        lines.append("Noise floor of the truth: unknown, no gyro is recorded.")
    elif board.headline != "exact":
        lines.append(
            f"Noise floor of the truth: {board.noise_floor:.4f} deg/m ({TOLD_FROM[yaw_noise(recordings).source]}); "
            "rows below it have no letter."
        )
    if silent := silent_experts(recordings):
        lines.append(f"No increment in any step: {', '.join(silent)}; such a row shows what stands in for it.")
    instantly = {row.name: row for row in board.standings[0].rows if not row.fused and row.lost_instantly}
    if instantly:
        counts = ", ".join(f"{name} {mean_std_text(row, row.lost_instantly)}" for name, row in instantly.items())
        lines.append(f"Lost per scene if cameras tracked again with the first good pair of images: {counts}.")
    if order := firing_order(recordings, board.headline):
        lines += firing_lines(order)
    if board.logs < RANKING_LOGS:
        lines.append(f"{size}: enough to see that everything works, claims no ranking (takes {RANKING_LOGS} logs).")
    return lines


def _of_agents(board: Leaderboard) -> list[str]:
    """Which observation the agents of reinforcement learning see."""
    rows = [row for standings in board.standings for row in (*standings.rows, *standings.one_fold_rows)]
    sees = {row.name: policy.sees for row in rows for policy in row.run.policies.values() if policy.sees}
    found = [(one, [name for name in sees if sees[name] == one]) for one in sorted(set(sees.values()))]
    what = {"paper": "the gate's x and the experts' yaw rates", "rich": "these and inliers, residuals, disagreement"}
    return [
        f"Learned from the environment's reward: {', '.join(names)}, shown its observation {one!r}: {what[one]}."
        for one, names in found
    ]


def _of_imports(board: Leaderboard) -> list[str]:
    """What differs where experts come from files."""
    manifest = board.recordings.manifest
    if not manifest.imported:
        return []
    lines = [
        "Imported experts: " + ", ".join(manifest.imported) + "; only their yaw is used, all rows share one distance."
    ]
    if not manifest.inertial:
        lines.append(
            "No inertial expert is recorded: an expert that is lost is replaced by the median of those that are not; "
            "PAPER, VISION and CONSUMER are the same."
        )
    if not manifest.cameras and not manifest.counted:
        lines.append("No match counts are recorded: MIXO sees yaw rate and speed alone, HIGHEST MATCH has no row.")
    return lines


def distance_words(manifest: Manifest) -> str:
    """Where the distance comes from, unless it is the wheels and gyro of every recording; said in every title."""
    if manifest.distance == TRUE_DISTANCE:
        return "; distance from the ground truth (privileged)"
    return "" if manifest.distance == "INERTIAL" else f"; distance from {manifest.distance}"


def _truths(board: Leaderboard) -> str:
    """The headline's truth, and the others."""
    names = TRUTH_NAMES if "written" in board.truths else TRUTH_NAMES | {"truth": TRUTH_NAMES["written"]}
    others = "".join(f"; {truth}: {names[truth]}" for truth in board.truths if truth != board.headline)
    return f"Headline truth: {names[board.headline]}{others}."


def _folds(board: Leaderboard) -> str:
    protocol = board.protocol
    manifest = board.recordings.manifest
    if protocol.foreign and manifest.imported:
        return (
            "Fewer than two folds: nothing to learn from that is not tested, so there are no learned policies; wheel "
            "scale and course offset are nominal."
        )
    if protocol.foreign:
        return (
            "Fewer than two folds: learned policies were fitted on the bundled recordings, wheel scale and course "
            "offset are nominal."
        )
    folds = (
        f"{len(protocol.folds)} folds by log: learned policies, wheel scale and course offset are fitted on the other "
        "folds."
    )
    if any(standings.one_fold is not None for standings in board.standings):
        part = {row.name for t in board.standings for row in t.one_fold_rows} - {
            r.name for t in board.standings for r in t.rows
        }
        verb = "is" if len(part) == 1 else "are"
        folds += f" {', '.join(sorted(part))} {verb} fitted once and tested on fold {protocol.tested_folds[-1]}."
    return folds


def firing_lines(order: FiringOrder) -> list[str]:
    """Eq. 2 and LINEAR's weights at the steps and at the cameras' own windows."""

    def told(told: Told) -> str:
        parts = zip(order.cameras, told.best_share, told.weights, strict=True)
        cameras = ", ".join(f"{camera} {100 * share:.0f} % / {weight:.2f}" for camera, share, weight in parts)
        return f"{cameras}; mixed {told.mixed_rms_deg:.4f} deg"

    cost = ", ".join(f"{camera} {added:.4f}" for camera, added in zip(order.cameras, order.cost_deg, strict=True))
    return [
        f"Locally best (eq. 2) / weight of least squares with sum one, {order.steps} moving steps with all cameras: at "
        f"the steps {told(order.at_steps)}; at the cameras' own windows {told(order.own_windows)}.",
        f"The firing order still costs [deg RMS a step]: {cost}.",
    ]


def count_of(number: int, noun: str) -> str:
    """Number and noun, in the plural where there are several."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def title(standings: Standings, manifest: Manifest) -> str:
    """What votes in this track, and where the distance comes from."""
    inertial, own = TRACKS[standings.track], [name for name in manifest.imported if not is_family_expert(name)]
    who = " and ".join(
        ["the cameras"] * bool(manifest.cameras)
        + ["the imported experts"] * bool(own if manifest.cameras else manifest.imported)
        + ["the experts of other families"] * (standings.track == UNEQUAL)
    )
    if not who:
        votes = f"{inertial} votes alone"
    elif not manifest.inertial:
        votes = f"{who} vote"
    else:
        votes = f"{who} and {inertial} vote" if inertial else f"{who} vote, inertial gives distance and bridges"
    return f"Track {standings.track}: {votes}{distance_words(manifest)}"


def notes(standings: Standings) -> list[str]:
    """Comparisons, LINEAR's weights and what was left out."""
    lines = comparison_lines(standings.comparisons)
    if weights := standings.linear_weights():
        experts = next(iter(weights.values()))
        mean = {expert: float(np.mean([fold[expert] for fold in weights.values()])) for expert in experts}
        parts = ", ".join(f"{expert} {weight:.3f}" for expert, weight in mean.items())
        lines.append(
            f"LINEAR weights{', mean over folds' if len(weights) > 1 else ''}: {parts}; sum {sum(mean.values()):.3f}."
        )
    return lines + left_out_lines(standings.left_out)


def left_out_lines(left_out: Mapping[str, str]) -> list[str]:
    """Why rows are missing: a line a reason."""
    rows = {why: [name for name in left_out if left_out[name] == why] for why in left_out.values()}
    return [f"{', '.join(names)} left out: {why}." for why, names in rows.items()]


def comparison_lines(comparisons: Comparisons) -> list[str]:
    """The confirmatory family pair by pair, and the size of the exploratory one."""
    lines = []
    if family := comparisons.confirmatory:
        lines.append(
            f"Confirmatory, {count_of(len(family), 'difference')} in RTE deg/m fixed beforehand, paired over "
            f"{count_of(comparisons.logs, 'log')}; p (corrected after Holm), true difference detectable at 80 % power "
            "(at Holm's strictest level): " + "; ".join(map(_confirmed, family)) + "."
        )
    there = {(found.first, found.second) for found in comparisons.confirmatory}
    if comparisons.exploratory and (absent := [pair for pair in CONFIRMATORY if pair not in there]):
        lines.append(
            "Fixed beforehand, but not in the confirmatory family because a row is missing: "
            + ", ".join(f"{first} - {second}" for first, second in absent)
            + "."
        )
    if family := comparisons.exploratory:
        lines.append(
            f"Exploratory: letters and the columns - LINEAR, - MIXO come from all {count_of(len(family), 'pair')} of "
            "rows without a dagger, Holm-corrected by themselves."
        )
    return lines


def _confirmed(found: Comparison) -> str:
    low, high = (end / found.second_error for end in (found.difference.low, found.difference.high))
    reach, strict = (end / found.second_error for end in (found.detectable, found.detectable_holm))
    return (
        f"{found.first} - {found.second} {percent(found.share)} [{percent(low)}, {percent(high)}], "
        f"p {p_text(found.p_value)} ({p_text(found.p_holm)}), detectable {100 * reach:.1f} % ({100 * strict:.1f} %)"
    )


def percent(share: float) -> str:
    """A signed percentage."""
    return "-" if np.isnan(share) else f"{100 * share:+.{0 if abs(share) >= 1.0 else 1}f} %"


def p_text(p_value: float) -> str:
    """A p-value in four decimals, without the leading zero."""
    return "<.0001" if p_value < 1e-4 else "1" if p_value > 0.99995 else f"{p_value:.4f}".removeprefix("0")


def mean_std_text(row: Row, lost: LostTracks | None) -> str:
    """Tracks lost per scene."""
    mean_std = lost_mean_std(row, lost)
    return "-" if mean_std is None else f"{mean_std[0]:.2f} ± {mean_std[1]:.2f}"


def lost_mean_std(row: Row, lost: LostTracks | None) -> tuple[float, float] | None:
    """Mean and standard deviation over the tested scenes."""
    if lost is None:
        return None
    counts = lost.counts[row.run.tested]
    return float(counts.mean()), float(counts.std())
