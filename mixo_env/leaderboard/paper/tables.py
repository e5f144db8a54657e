"""The paper's tables, ours beside the printed numbers: other data, so nothing is compared but the order of rows."""

from __future__ import annotations

import numpy as np

from mixo_env.leaderboard.firing_order import MOVING_MPS, best_shares
from mixo_env.leaderboard.paper import printed
from mixo_env.leaderboard.paper.parts import FRONT, NotHereError, Subject, marked
from mixo_env.leaderboard.rows import Row
from mixo_env.leaderboard.sentences import mean_std_text
from mixo_env.policies.linear import Linear
from mixo_env.recordings.joint import JOINT
from mixo_env.tables import Cell, Column, Table

NAN = float("nan")


def table_1(subject: Subject) -> Table:
    """Every row of Table I; one that we have not is a dash on our side, never left out."""
    rows = []
    for line in printed.TABLE_1:
        row = subject.rows.get(line.name)
        score = None if row is None else row.headline
        rows.append(
            [
                line.label,
                line.translation_percent,
                NAN if score is None else score.translation_percent.mean,
                line.rotation_deg_per_m,
                NAN if score is None else score.rotation_deg_per_m.mean,
                f"{line.lost_mean:.2f} ± {line.lost_std:.2f}",
                None if row is None else mean_std_text(row, row.lost),
            ]
        )
    absent = [line.name for line in printed.TABLE_1 if line.name not in subject.rows]
    without = f" Not run or not recorded here: {', '.join(absent)}." if absent else ""
    caption = (
        f"Table I. Printed: {printed.PRINTED_ON}. Ours: {subject.data}. Other data: only the order of rows can be "
        f"compared. Pooled RTE; tracks lost per scene, mean ± standard deviation.{without}"
    )
    return Table(
        caption, _beside(("transl.", "%", ".2f", ".2f"), ("rot.", "deg/m", ".3f", ".4f"), ("lost", "", "", "")), rows
    )


def gain(subject: Subject) -> Table:
    """MIXO against the front camera."""
    front, mixo = subject.row(FRONT).headline, subject.row("MIXO").headline
    ours = [
        100.0 * (getattr(mixo, name).mean / getattr(front, name).mean - 1.0)
        for name in ("translation_percent", "rotation_deg_per_m")
    ]
    rows = [
        [what, said, value]
        for what, said, value in zip(("translation", "rotation"), printed.GAIN_PERCENT, ours, strict=True)
    ]
    caption = (
        f"MIXO against CAM_FRONT. Printed: the text on {printed.PRINTED_ON} (the rounded numbers of its Table I give "
        f"-14 % and -34 %). Ours: {subject.data}."
    )
    return Table(caption, _beside(("change", "%", "+.0f", "+.0f")), rows)


def table_2_printed() -> Table:
    """MIXO by split, as printed."""
    rows = [[split, *values] for split, values in printed.TABLE_2.items()]
    columns = Column("split"), Column("transl.", "%", ".2f"), Column("rot.", "deg/m", ".3f")
    return Table(f"Table II as printed: MIXO on {printed.PRINTED_ON}, four blocks of scenes.", columns, rows)


def table_2(subject: Subject) -> Table:
    """Every method by fold; an overall value only where all folds were tested.

    Raises:
        NotHereError: with fewer than two folds.
    """
    folds = subject.board.protocol.tested_folds
    if len(folds) < 2:
        raise NotHereError("these recordings have fewer than two folds (one log, or no fold at all)")
    fold_of = np.array([scene.fold for scene in subject.board.recordings.scenes])
    columns = [Column("row")]
    for name in (*(f"fold {fold}" for fold in folds), "overall"):
        columns += [Column(name, "%", ".2f"), Column(name, "deg/m", ".4f")]
    rows = []
    for row in subject.rows.values():
        cells: list[Cell] = [marked(row)]
        for fold in folds:
            cells += _pooled(subject, row, np.flatnonzero((fold_of == fold) & row.run.tested))
        cells += _pooled(subject, row, np.arange(len(fold_of))) if row.run.tested.all() else [NAN, NAN]
        rows.append(cells)
    scenes = ", ".join(f"fold {fold}: {int((fold_of == fold).sum())}" for fold in folds)
    caption = (
        f"Table II for every method, tested on each fold with what was learned on the others. {subject.data}; whole "
        f"logs in a fold; scenes of {scenes}. † reads ground truth or the future; a dash: not tested there."
    )
    return Table(caption, tuple(columns), rows)


def _pooled(subject: Subject, row: Row, scenes: np.ndarray) -> list[float]:
    """RTE over all pieces of some scenes; NaN without a piece."""
    relative = row.errors[subject.board.headline].relative
    here = np.isin(relative.scene, scenes)
    if not here.any():
        return [NAN, NAN]
    return [float(relative.translation_percent[here].mean()), float(relative.rotation_deg_per_m[here].mean())]


def equation_2(subject: Subject) -> Table:
    """Who is locally best how often, among the cameras and among all voters.

    Raises:
        NotHereError: without cameras, or without a step in which all of them gave an increment.
    """
    cameras, judged = subject.cameras(), subject.judged
    voters = judged.voters(subject.track)
    turn = judged["truth.yaw_increment_rad"]
    errors = np.stack([np.abs(judged[f"{name}.yaw_increment_rad"] - turn) for name in voters], axis=1)
    seeing = errors[:, [voters.index(camera) for camera in cameras]]
    with np.errstate(divide="ignore", invalid="ignore"):
        moving = np.nan_to_num(np.abs(judged["truth.distance_m"]) / judged["dt_s"]) >= MOVING_MPS
    steps = moving & np.isfinite(seeing).all(axis=1)
    if not steps.any():
        raise NotHereError("there is no moving step in which every camera gave an increment")
    among_cameras = dict(zip(cameras, best_shares(seeing, steps), strict=True))
    among_all = best_shares(errors, steps)
    rows = [
        [name, 100.0 * printed.BEST_SHARE.get(name, NAN), 100.0 * among_cameras.get(name, NAN), 100.0 * float(share)]
        for name, share in zip(voters, among_all, strict=True)
    ]
    caption = (
        f"Eq. 2, share of steps at which each is locally best. Printed: {printed.PRINTED_ON}, among the cameras, of "
        f"the three other cameras only their mean. Ours: {subject.data}, {int(steps.sum())} moving steps in which "
        "every camera gave an increment; ties are split."
    )
    columns = Column("expert"), Column("printed", "%", ".0f"), Column("ours, cameras", "%", ".1f")
    return Table(caption, (*columns, Column("ours, all voters", "%", ".1f")), rows)


def linear_weights(subject: Subject) -> Table:
    """LINEAR's constant weights, ours the mean over the folds."""
    policies = [one for one in subject.row("LINEAR").run.policies.values() if isinstance(one, Linear)]
    if not policies:
        raise NotHereError("LINEAR was not fitted")
    ours = dict(zip(policies[0].experts, np.mean([policy.weights for policy in policies], axis=0), strict=True))
    rows = [[name, printed.LINEAR_WEIGHTS.get(name, NAN), float(weight)] for name, weight in ours.items()]
    rows.append(["sum", sum(printed.LINEAR_WEIGHTS.values()), float(sum(ours.values()))])
    caption = f"LINEAR's weights. Printed: {printed.PRINTED_ON}. Ours: {subject.data}, mean over the held-out folds."
    return Table(caption, _beside(("weight", "", ".3f", ".3f")), rows)


def by_length(subject: Subject) -> Table:
    """The numbers behind Fig. 7."""
    rows = subject.by_length()
    lengths = [at.length_m for at in rows[0].lengths]
    cells = [[marked(row), *(at.rotation_deg_per_m.mean for at in row.lengths)] for row in rows]
    cells.append(["pieces", *(at.samples for at in rows[0].lengths)])
    cells = [[cells_of[0], *(_figure(value) for value in cells_of[1:])] for cells_of in cells]
    caption = f"RTE by length [deg/m], the lower half of Fig. 7. {subject.data}."
    return Table(caption, (Column("row"), *(Column(f"{length:g} m") for length in lengths)), cells)


def _figure(value: Cell) -> Cell:
    if isinstance(value, float):
        return None if np.isnan(value) else f"{value:.4f}"
    return value


def coupling(subject: Subject) -> Table:
    """Loose coupling against tight: accuracy, and what a step of all cameras costs.

    Raises:
        NotHereError: without cameras.
    """
    cameras, spent = subject.cameras(), subject.spent_ms
    seeing = [spent.get(camera, NAN) for camera in cameras]
    cost = {camera: spent.get(camera, NAN) for camera in cameras}
    cost |= dict.fromkeys(("LINEAR", "HUBER", "MIXO"), float(sum(seeing)))
    cost[JOINT] = float(sum(seeing)) + spent.get(JOINT, NAN)
    kinds = dict.fromkeys(cameras, "one camera") | dict.fromkeys(("LINEAR", "HUBER", "MIXO"), "loose")
    rows = [_coupled(subject, name, kind, cost[name]) for name, kind in (kinds | {JOINT: "tight"}).items()]
    low, high = printed.FRAME_MS
    caption = (
        f"Loose against tight coupling. {subject.data}. CPU: median of a camera's image; of a fused row the sum of the "
        f"cameras (mixing itself is not in it), of {JOINT} with the solve of a step. Printed: {low:.0f} to {high:.0f} "
        f"ms a frame; {printed.REAL_TIME_MS:.1f} ms is real time for all cameras."
    )
    columns = Column("row"), Column("coupling"), Column("transl.", "%", ".2f"), Column("rot.", "deg/m", ".4f")
    return Table(caption, (*columns, Column("ATE", "m", ".2f"), Column("CPU", "ms", ".1f")), rows)


def _coupled(subject: Subject, name: str, kind: str, cost_ms: float) -> list[Cell]:
    row = subject.rows.get(name)
    cost: Cell = "not recorded" if np.isnan(cost_ms) else cost_ms
    if row is None:
        recorded = name != JOINT or JOINT in subject.recordings.manifest.variants
        return [name, kind, "not run" if recorded else "not recorded", None, None, cost]
    score = row.headline
    return [name, kind, score.translation_percent.mean, score.rotation_deg_per_m.mean, score.ate_m, cost]


def _beside(*quantities: tuple[str, str, str, str]) -> tuple[Column, ...]:
    """A name, and every quantity as printed and ours: heading, unit, format of the printed and of ours."""
    columns = [Column("row")]
    for heading, unit, printed_spec, spec in quantities:
        columns += [Column(f"{heading}, printed", unit, printed_spec), Column(f"{heading}, ours", unit, spec)]
    return tuple(columns)
