"""The section of docs/odometry.md about JOINT; its tables come from experiments.joint_odometry and its scenes."""

JOINT_TEXT = r"""
## JOINT: all cameras in one estimate

`mixo record --experts JOINT` also solves all cameras together (`mixo_env/experts/joint/`): what the single cameras
have matched, at most 300 matches of each, in one least-squares problem per step. Shared by the body are the yaw rate
at three closing times, linear in between, so that each camera is seen at its own image times; pitch and roll rate;
slip and heave. Each camera has an offset of its mounting, learnt slowly, and a yaw error of its own with heavy tails
(Student-t, three degrees of freedom) whose width follows from what its matches know. A tilt of the body swings the
cameras too. What three images of a camera say about the change of its turn enters beside the pairs. A camera that
contradicts the others has no say in that step, and for a second may err ten times as much: it is heard again as soon
as it agrees, but cannot take the rig along. A picture that stands still while the car drives has no say either; a
camera whose learnt offset stays beyond a degree is misplaced: named, and left out from then on. No gyro and no pose
enters. JOINT is a row of the leaderboard where it was recorded; it never votes and enters no oracle.

At the end of each step the increment of the rig leans half of the way towards what the cameras' own odometries have
reported for their windows (`headings.py`: Student-t, by their standard deviations). So JOINT is no purely tight
coupling: the rig alone is. Both come from the same matches but err differently, and together they are better than
either (.0015 and .0020 deg/m against .0016 and .0023 of the rig alone, in two cities of an earlier simulator).

Relative rotation error [deg/m] against exact truth, 40 scenes of 20 logs in each of two cities that nothing was
fitted or chosen on, and the 320 scenes of the bundled one:

| | seed 101 | rain (8) | turning (12) | seed 102 | rain (8) | turning (12) | bundled | rain (68) | turning (105) |
|---|---|---|---|---|---|---|---|---|---|
| CAM_FRONT | .00262 | .00325 | .00335 | .00337 | .00350 | .00596 | .00312 | .00495 | .00455 |
| CAM_FRONT_LEFT | .00703 | .00876 | .00614 | .00768 | .02364 | .00746 | .00641 | .00857 | .00732 |
| CAM_BACK | .00460 | .00745 | .00418 | .00393 | .00670 | .00446 | .00416 | .00613 | .00439 |
| CAM_BACK_RIGHT | .01428 | .01361 | .01069 | .01279 | .01598 | .01141 | .01582 | .01807 | .01705 |
| HUBER of the four | .00274 | .00393 | .00276 | .00266 | .00405 | .00327 | .00263 | .00393 | .00305 |
| JOINT | .00175 | .00253 | .00149 | .00195 | .00227 | .00314 | .00174 | .00267 | .00202 |

```sh
mixo simulate seed-101 --scenes 40 --scenes-per-log 2 --night 0 --seed 101    # 102 likewise
mixo record seed-101 --out recorded-101 --experts JOINT
python -m experiments.joint_odometry --recordings recorded-101                # or mixocity
```

JOINT is 33, 42 and 44 % below the best single camera, 36, 27 and 34 % below HUBER, and behind it in no subset: not by
day, in rain, or in turns. Increments lie within 1 (1.96) of their standard deviations in 78, 75 and 76 % (97, 96 and
96 %). Single increments are noisier than HUBER's (.0083, .0088 and .0087 against .0062, .0061 and .0065 deg). The
solve costs 2.0 to 2.4 ms of CPU time in the median, the stateless one beside it included (3.0 ms before the step was
laid out once for both and its small loops were compiled; in turns on one busy machine .72 times, 95 % interval .70 to
.73), and each camera's image about 7 ms. Its weights were chosen on ten scenes of a city that an earlier simulator
drew, after 20 had shown that most other weights make no difference beyond chance.

What limits it: each camera's error has a part that lasts for seconds (CAM_BACK drifts .001 deg per step to the left in
nearly every scene; the cause is spread over the picture and was not found). Widening the errors of single cameras
for it helps in one half of a city as much as it harms in the other.

With one camera captured or frozen in the pictures themselves, eight drives of eight logs each that nothing was chosen
on (`--scenes 8 --scenes-per-log 1 --rain 0 --night 0`), JOINT of all four beside JOINT of the other three (`mixo record
--cameras`), deg/m:

| drives | HUBER of four | JOINT of four | JOINT without that camera |
|---|---|---|---|
| `mixo simulate --situation following_van --seed 201`: CAM_BACK | .00168 | .00119 | .00168 |
| `mixo simulate --situation lead_truck --seed 202`: CAM_FRONT | .00369 | .00316 | .00286 |
| `--situation ordinary --fault.kind frozen --fault.camera CAM_BACK --seed 203` | .00215 | .00166 | .00168 |

So a van behind costs nothing (the camera is still worth hearing), a truck ahead 10 %, a frozen picture nothing.

With one camera spoilt, eight scenes of that earlier city (JOINT .00171); the captured camera's own odometry is taken
to be deceived as well:

| camera | left out (a black picture) | sees a vehicle turn by .23 deg a step for 4 s | picture stands still for 4 s |
|---|---|---|---|
| CAM_FRONT | .00314 | .00239 | .00182 |
| CAM_FRONT_LEFT | .00166 | .00176 | .00171 |
| CAM_BACK | .00190 | .00186 | .00193 |
| CAM_BACK_RIGHT | .00152 | .00155 | .00163 |

A captured camera costs at most 6 % over the remaining three, a standing picture at most 8 %. Before a camera that had
contradicted the rig was doubted for a second, two steps of a creeping car in which CAM_BACK took the rig along made
that 41 %. Smaller lies are harder: with .07 deg a step for 4 s, made by hand, a captured CAM_BACK costs 38 % (+370 %
before), CAM_FRONT nothing.
"""
