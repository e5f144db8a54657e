"""Write docs/manoeuvres.md and its figure.

python -m docs._pages.manoeuvres_page
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from experiments.manoeuvres import GATES, Finding, study
from mixo_env.files import write_text
from mixo_env.leaderboard.manoeuvres import MANOEUVRES
from mixo_env.leaderboard.paper.weights import draw_by_manoeuvre
from mixo_env.recordings.store import load_recordings

PAGE = Path(__file__).parents[1] / "manoeuvres.md"
FIGURE = PAGE.parent / "figures" / "manoeuvres.png"

TEXT = """# Whom do gates prefer, and when?

<!-- Written by `python -m docs._pages.manoeuvres_page`; change that. -->

The paper's central claim is that a small network can tell from yaw rate, speed and matches which camera to trust: a
gate that prefers cameras by what the car is doing. It prints no weights. Here they are, on held-out folds of the
bundled city, track PAPER (the paper's five experts), by `python -m experiments.manoeuvres`.

![Mean weights of every gate, straight, left, right and standing](figures/manoeuvres.png)

A frame: the weight differs from the one on straight road by more than chance (95 % interval over logs).

{table}

In brackets the change from straight road where its interval excludes 0. Steps in which every expert gives an increment;
learned gates: mean of three seeds; PPO on the last fold alone. Turning is .05 rad/s or more, standing below .2 m/s.
MULTICAMERA GT †: how often each camera is nearest the truth. LINEAR BY MANOEUVRE † is told the manoeuvre by the truth
and has constant weights for each, fitted on the other folds.

## What it says

* **The claim holds in kind.** MIXO does prefer cameras by manoeuvre, beyond chance: in left turns CAM_BACK and
  CAM_FRONT_LEFT gain what CAM_FRONT and the gyro lose, in right turns CAM_BACK and CAM_FRONT gain what CAM_FRONT_LEFT
  and the gyro lose. Constant weights fitted for each manoeuvre alone (LINEAR BY MANOEUVRE †) move much the same way.
  The truth (MULTICAMERA GT †) agrees about CAM_BACK; it has CAM_FRONT lose in turns of both kinds.
* **It is worth little.** Told the manoeuvre by the truth, constant weights reach {told:.2f} 10⁻³ deg/m where LINEAR has
  {linear:.2f}; MIXO, which also sees matches, {mixo:.2f}. TOKEN, which looks at disagreement, has {token:.2f}, and
  TRIO, which also looks at it without the biases that a filter predicts, {trio:.2f}: who errs *now* matters more than
  what the car does. In turns TOKEN leaves the gyro next to nothing.
* HUBER's means move by a hundredth and it is ahead of MIXO; LINEAR's do not move at all beyond what its four fits
  differ by. PPO, on its one fold, moves as MIXO does, and less.
* While the car stands errors are six times smaller, and weights matter little.
* What differs from the paper: CAM_BACK is as good as CAM_FRONT here ([fusion.md](fusion.md)), so a gate has less to
  move than with the paper's weak rear and side views. Its claim on nuScenes stays open until someone records that:
  `python -m experiments.manoeuvres --recordings FOLDER`.
"""


def page(findings: Sequence[Finding]) -> str:
    """The whole page."""
    score = {finding.preference.row: 1e3 * finding.deg_per_m for finding in findings}
    told = next(value for row, value in score.items() if row.startswith("LINEAR BY"))
    of_rows = {name.lower(): score[name] for name in ("LINEAR", "MIXO", "TOKEN", "TRIO")}
    return TEXT.format(table=weight_table(findings), told=told, **of_rows)


def weight_table(findings: Sequence[Finding]) -> str:
    """A line a row and manoeuvre."""
    experts = findings[0].preference.experts
    lines = [
        f"| | | {' | '.join(experts)} | RMS [deg] | all [10⁻³ deg/m] |",
        "|---|---|" + "---:|" * (len(experts) + 2),
    ]
    for finding in findings:
        one = finding.preference
        for k in np.flatnonzero(one.steps):
            cells = [
                f"{one.mean[k, e]:.2f}" + (f" ({one.change[0, k, e]:+.2f})" if one.changed[k, e] else "")
                for e in range(len(experts))
            ]
            first = k == np.flatnonzero(one.steps)[0]
            name, total = (one.row, f"{1e3 * finding.deg_per_m:.2f}") if first else ("", "")
            lines.append(f"| {name} | {MANOEUVRES[k]} | {' | '.join(cells)} | {one.rms_deg[k]:.4f} | {total} |")
    return "\n".join(lines)


if __name__ == "__main__":
    findings = study(load_recordings(None), "PAPER", (*GATES, "PPO"))
    draw_by_manoeuvre([finding.preference for finding in findings], FIGURE)
    write_text(PAGE, page(findings))
    print(f"wrote {PAGE} and {FIGURE}")
