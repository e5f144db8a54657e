"""Write docs/lies.md and its figure.

python -m docs._pages.lies_page
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from experiments.lies import CONDITIONS, Verdict, draw, judge, watch
from mixo_env.files import write_text
from mixo_env.recordings.store import load_recordings

PAGE = Path(__file__).parents[1] / "lies.md"
FIGURE = PAGE.parent / "figures" / "lies.png"

TEXT = """# Does this odometry lie now?

<!-- Written by `python -m docs._pages.lies_page`; change that. -->

You drive with an odometry and want an alarm when it is wrong. Which of the numbers it gives can you trust?

**In short: compare it with the others.** Take the robust consensus of your *other* odometries and look how far this
one is from it in this step. On held-out drives that finds nine of ten lies at {least:.0f} to {most:.0f} false alarms a
minute, of 600 steps. What an odometry says of itself finds them at {own_least:.0f} false alarms a minute at the very
best: its stated standard deviation is the best of these. Its matches and inliers, which most programs show, are no
better than a coin for the front camera in rain and by night.

A *lie* is a step whose yaw increment errs by more than {limit:.0f} sigma_0, {limit_deg:.3f} deg here, by exact truth
(sigma_0: the robust spread of LINEAR's error). It is rare ahead and behind and common at the sides.

![ROC curves of every signal, a panel a camera](figures/lies.png)

Dashed: what an odometry tells of itself. Solid: what needs others.

| signal | what it is |
|---|---|
| few matches, few inliers | of this step; inliers as a share of the matches |
| residual, flow | median of the inliers [px], median length of the matches [px] |
| stated deviation | standard deviation that it states of its increment |
| jump | change of its own yaw rate since the last step |
| two images | what its memory changed about the increment of the two images alone |
| disagreement | distance from the STUDENT-T consensus (nu = 5) of the others |
| disagreement, lately | its exponentially forgetting mean, about a second |
| combined | least squares of the log error on the logs of all these, fitted on other drives |

Every signal is known when its step is over, and none sees the truth. `python -m experiments.lies` prints all numbers,
also for another track or for recordings of your own.

## How well each warns

Area under the ROC curve (.5 for a coin, 1 for a perfect alarm), its 95 % interval over logs, and false alarms a minute
where 90 % of the lies are found; all {scenes} scenes, every fold judged by what other folds tell:

{signals}

## Where

Area under the curve by condition. *Together*: of all lies only those in which another camera lies to the same side. A
dash: fewer than ten lies.

{conditions}

* By night nearly every fifth step of CAM_FRONT_LEFT and every third of CAM_BACK_RIGHT lies. What these say of
  themselves is then worth less than by day; disagreement is worth nearly as much.
* The combination loses to disagreement alone. It is fitted on poses as real drives have them, whose noise in one step
  is as large as the usual error of a camera.
* A threshold that fits: {threshold:.3f} deg of disagreement in a step finds nine of ten lies of the four cameras
  (between {threshold_low:.3f} and {threshold_high:.3f} deg, camera by camera).

## What it does not tell

* **Two of a kind.** Where traffic captures two cameras at once (*together*) the consensus leans with them: the front
  camera's lies are then found less surely. Where most are captured, nothing of this helps.
* **Slow lies.** A drift of .005 deg a step never passes the limit of one step, and turns the heading by a degree in
  twenty seconds. Which rows survive that is told in [fusion.md](fusion.md).
* **Simulated streets.** The cameras are of one family, and their errors are nearly independent but for traffic. On real
  drives there is no exact truth to count lies by; what happens where a real odometry breaks is told in
  [real-experts.md](real-experts.md).
"""


def page(verdicts: list[Verdict], limit: float, limit_deg: float, scenes: int) -> str:
    """The whole page."""
    overall = [v for v in verdicts if v.condition == "all"]
    of_others = [v for v in overall if v.signal == "disagreement"]
    own = [v.per_minute for v in overall if not v.signal.startswith(("disagreement", "combined"))]
    at_deg = [float(np.degrees(v.threshold)) for v in of_others]
    return TEXT.format(
        least=min(v.per_minute for v in of_others),
        most=max(v.per_minute for v in of_others),
        own_least=np.nanmin(own),
        limit=limit,
        limit_deg=limit_deg,
        scenes=scenes,
        signals=signal_table(overall),
        conditions=condition_table(verdicts),
        threshold=float(np.median(at_deg)),
        threshold_low=min(at_deg),
        threshold_high=max(at_deg),
    )


def signal_table(overall: list[Verdict]) -> str:
    """A row a signal, a column an expert."""
    by = {(v.signal, v.expert): v for v in overall}
    experts, signals = (list(dict.fromkeys(key[k] for key in by)) for k in (1, 0))
    rows = [f"| | {' | '.join(experts)} |", "|---|" + "---:|" * len(experts)]
    for signal in signals:
        cells = [_cell(by[signal, expert]) for expert in experts]
        rows.append(f"| {signal} | {' | '.join(cells)} |")
    return "\n".join(rows)


def condition_table(verdicts: list[Verdict]) -> str:
    """A row an expert and condition, a column a signal."""
    by = {(v.expert, v.condition, v.signal): v for v in verdicts}
    experts, signals = (list(dict.fromkeys(key[k] for key in by)) for k in (0, 2))
    rows = [f"| | lies | {' | '.join(signals)} |", "|---|---:|" + "---:|" * len(signals)]
    for expert in experts:
        for condition in (c for c in CONDITIONS if (expert, c, signals[0]) in by):
            shown = [by[expert, condition, signal] for signal in signals]
            cells = [f"{v.area.mean:.2f}".replace("nan", "-") for v in shown]
            rows.append(f"| {expert}, {condition} | {100.0 * shown[0].share:.2f} % | {' | '.join(cells)} |")
    return "\n".join(rows)


def _cell(verdict: Verdict) -> str:
    area = verdict.area
    if np.isnan(area.mean):
        return "-"
    return f"{area.mean:.2f} [{area.low:.2f}, {area.high:.2f}], {verdict.per_minute:.0f}/min"


if __name__ == "__main__":
    recordings = load_recordings(None)
    watched = watch(recordings)
    draw(watched, FIGURE)
    limit_deg = float(np.degrees(4.0 * recordings.manifest.reward_scale_rad["VISION"]))
    write_text(PAGE, page(judge(watched), 4.0, limit_deg, len(recordings)))
    print(f"wrote {PAGE} and {FIGURE}")
