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

TUTORIAL_TEXT = r"""
Errors of one step's increment while the car moves, five day scenes of a city of seed 101 (right and left turn, blank
wall, stop and go, standing; `python -m experiments.unequal_experts`), and the time of an image on one thread:

| | tells | lost per scene | median, all steps | RMS | worst 5 % above | CPU |
|---|---:|---:|---:|---:|---:|---:|
| CAM_FRONT | 97.3 % | .00 | .0024 deg | .0073 deg | .015 deg | 8 ms |
| CAM_FRONT_LEFT | 96.9 % | .00 | .0038 deg | .0168 deg | .036 deg | 8 ms |
| CAM_BACK | 97.4 % | .00 | .0020 deg | .0072 deg | .015 deg | 8 ms |
| CAM_BACK_RIGHT | 96.8 % | .20 | .0087 deg | .0370 deg | .084 deg | 7 ms |
| TUTORIAL_FRONT | 73.2 % | 17.6 | .050 deg | .491 deg | .65 deg | 55 ms |
| TUTORIAL_FRONT_LEFT | 65.6 % | 17.8 | .500 deg | 1.46 deg | 3.2 deg | 55 ms |
| TUTORIAL_BACK | 65.7 % | 6.8 | .071 deg | .428 deg | .42 deg | 57 ms |
| TUTORIAL_BACK_RIGHT | 55.5 % | 14.6 | .835 deg | 4.79 deg | 5.9 deg | 51 ms |

The paper's cameras lose track 14.3 times a scene. On 51 real images (KITTI 06) TUTORIAL has median .082 deg, RMS 2.27
deg, one step wrong by 14 deg, and is never lost; the odometry of this page .005 and .041 deg. In UNEQUAL on the five
scenes MEAN becomes useless (.0985 deg/m against .0051 in VISION) and HIGHEST MATCH worse (.209 against .0035), because
TUTORIAL's matches are many and say little; MEDIAN doubles its error (.0051 against .0025), LINEAR and HUBER, fitted on
other drives, keep theirs (.0024 and .0021 against .0023 and .0020). Five scenes claim no ranking.
"""


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
