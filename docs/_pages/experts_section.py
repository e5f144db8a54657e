"""The part of docs/odometry.md about experts of other families, and how well all experts know their errors."""

from __future__ import annotations

from experiments.calibration import CONDITIONS, LIMITS, Told

TEXT = r"""
## Which expert is which

| expert | what it is | needs | votes in |
|---|---|---|---|
| CAM_FRONT, ... | single-camera odometry of this page, with memory | one camera, mounting, distance | every track |
| INERTIAL | wheels and IMU; gives distance and bridges | CAN bus | none |
| INERTIAL_POSE, INERTIAL_CONSUMER | the paper's, and a production-grade gyro | CAN bus | PAPER, CONSUMER |
| JOINT | all cameras in one estimate | all cameras' matches | none: a row everywhere |
| TUTORIAL_FRONT, ... | the odometry everyone writes first | one camera, mounting | UNEQUAL |
| ORBSLAM3_FRONT, ... | imported live poses of a peer | files | UNEQUAL |
| LEARNED_FRONT, ... | learned features | one camera | UNEQUAL |

| signal | cameras | inertial | JOINT | TUTORIAL | imported |
|---|---|---|---|---|---|
| standard deviation | yes | yes | yes | no: it has none | if its file says so |
| matches | yes | - | of all cameras | yes | if its file says so |
| inliers, residual | yes | - | yes | yes | - |
| flow | yes | - | - | yes | - |
| state | yes | - | yes | yes | yes |

What an expert does not say is absent (NaN in the recording, 0 in an observation) and never invented.

## TUTORIAL: the odometry everyone writes first

`mixo record --experts TUTORIAL` runs it on every camera (`mixo_env/experts/tutorial.py`), under names such as
TUTORIAL_FRONT_LEFT: 2000 ORB corners, brute-force matching with the ratio test (.75), the five-point essential matrix
by OpenCV's classic RANSAC (1 px, .999), its decomposition, and the car's yaw read off the rotation turned by the known
mounting. No prior, no ground, no course, no memory; neither distance nor gyro nor pose enters. It is LOST with fewer
than 30 matches, fewer than 15 inliers, or if fewer than 15 points come to lie in front of both cameras.

It fails as such odometries do. Standing still leaves the essential matrix undetermined: it is lost then, or its
rotation is noise, and nothing it says tells. A vehicle or a plane that fills the view is taken for the world. Now and
then the five points flip: a step is wrong by degrees, with as many inliers as ever.
{tutorial}
## The track UNEQUAL

Fusion is worth something where experts differ and fail. In UNEQUAL the experts of other families vote beside the
cameras' own odometry; in PAPER, VISION and CONSUMER they do not, and recording them changes no observation, vote,
reward scale or row there. Their own rows stand in the table of UNEQUAL alone. `mixo benchmark --tracks UNEQUAL` and
`gym.make("MixoOdometry-v0", track="UNEQUAL")` need recordings that hold at least one of them. The budget environment
does not play it: these experts have no price.

## Do the experts know how wrong they are?

![Stated and observed coverage by day, in rain and at night](figures/odometry-calibration.png)

Share of the increments within 1 and within 1.96 of their own standard deviations of the exact truth, on the bundled
recordings (`python -m experiments.calibration`, which prints more); calibrated would be 68.3 and 95.0 %:

{calibration}

By day the front cameras are too modest in the middle of the distribution and right at its end: errors have heavier
tails than a normal distribution, and one number cannot fit both. In rain CAM_BACK is a little too sure of itself.
The two better inertial grades state seven to nine times their error in one step: their filter's process noise allows
for drift that a single step does not show. So standard deviations may be compared between cameras, not between cameras
and INERTIAL or INERTIAL_POSE.
"""

TUTORIAL_TEXT = ""


def experts_section(told: list[Told]) -> str:
    """The text.

    Args:
        told: of the bundled recordings.
    """
    return TEXT.format(tutorial=TUTORIAL_TEXT, calibration=calibration_table(told))


def calibration_table(told: list[Told]) -> str:
    """Coverage by expert and condition, in Markdown."""
    heading = " | ".join(f"{name}, {share}" for name in CONDITIONS for share in LIMITS)
    rows = [f"| | {heading} |", "|---|" + "---:|" * (len(CONDITIONS) * len(LIMITS))]
    by = {(part.expert, part.condition): part for part in told}
    for expert in dict.fromkeys(part.expert for part in told):
        cells = [f"{by[expert, name].within(limit):.1f}" for name in CONDITIONS for limit in LIMITS.values()]
        rows.append(f"| {expert} | {' | '.join(cells)} |")
    return "\n".join(rows)
