"""The words of the data sheet. What is measured comes from elsewhere; settings named here are the code's."""

HEAD = """# The simulated city

<!-- Written by `python -m docs._pages.data_sheet`; change that. -->

The data sheet of `{data}`, the recordings that come with the package: how they were made, how they compare with
real driving, and what nobody fitted. nuScenes cannot be shipped; this city stands in for it, so that everything
works without data and results on it are worth something. It is simulated: claims about real driving need real
recordings.
"""

HOW_MADE = """## How it was made

`make mixocity` does everything, resumable; stage by stage it is `python -m experiments.mixocity`. In short:

1. **Plan.** A configuration and a seed decide logs, weather, rigs, sensors and situations before anything is driven
   (`mixo_env/simulator/drive/scenario.py`). Equal configurations give equal files, whatever the number of workers.
2. **Drive.** A route through a street grid, a speed profile within limits of acceleration and jerk, a body that
   pitches, rolls, heaves and slips, other vehicles, and people on foot and on bicycles around it (`drive`, `routes`,
   `traffic`, `people`).
3. **Sense.** CAN messages with the noise, bias, latency and gaps of the real car (`vehicle_bus`), written poses
   with the wandering of a real localisation (`localisation`), written calibrations and time stamps with small
   errors (`rig`, `clock`). The noise-free truth is kept apart, and both scores are shown.
4. **See.** Each log has a city of its own, rendered through four of the six nuScenes cameras (`world`, `render`,
   `sensor`), with what [lens, light and people](#lens-light-and-people) do.
5. **Record.** The project's experts run over the images once (`mixo record`). Only the recordings are shipped:
   `mixocity` (all scenes; four cameras, inertial experts, JOINT), `mixocity-rows` (28 drives of it, 7 of every fold,
   one a log, with rows and experts that cost more: TUTORIAL, LEARNED, ORBSLAM3, retrained vocabularies) and
   `mixocity-paper` (8 of these again at 1600 x 900 with preset `paper`); the first two with the CPU time of images.
   [odometry.md](odometry.md) compares their experts.

Calibrated were pictures, motion and CAN bus, against the real figures below and nothing else: neither expert
failures nor shares of locally best cameras nor the order of methods were looked at while the simulator was set.
"""

EFFECTS = """### Lens, light and people

Each follows a description that others have measured; none was set by what it does to an odometry.

* **People** walk at 1.3 ± 0.2 m/s (Bohannon and Andrews 2011) on pavements and over crossings, where they wait until no
  vehicle comes; one in five stands. Limbs have the proportions of Drillis and Contini (1966) and swing as in level
  walking (Perry and Burnfield 2010), in 16 poses a cycle that advance with the way. Cyclists ride at 4 to 6 m/s along
  the edge of the carriageway. By day about 7 people are around the car, as in a key frame of nuScenes (Caesar et al.
  2020), half as many in rain, a third at night.
* **Drops on the lens** in rain arrive as Marshall and Palmer (1948) count them at 4 mm/h, grow where they meet, run
  down when they become too heavy, and stay in place between images otherwise. How soft and how opaque they look follows
  from the distance of the glass and the opening of the lens; inside, they show the surroundings upside down (Garg and
  Nayar 2007). A wiper clears the glass before CAM_FRONT every 1.2 s; the other cameras have none.
* **A low sun** (7 to 16 degrees, along the streets) shines on a fifth of the logs by day. Lens and glass scatter 4 % of
  its light with the square of the angle (Vos and van den Berg 1999; Talvala et al. 2007): bloom and clipped sky around
  it, a grey veil over the rest, weak ghosts. Where a house hides the sun the veil is gone.
* **Underpasses** of 14 to 28 m lie over some streets. Light inside is what both ends let in (view factors). The
  exposure follows with a time constant of 0.3 s, as at every change of light: too dark going in, too bright coming out.
"""

LOGS = """Every log is one drive of one of two cars through a city of its own. Wheel radius: mean of the rear axle;
course: direction of travel minus heading; lag: how late the written poses are, the car's own; then the constant biases
of three yaw-rate sensors."""

SAMPLES = """Every situation and condition once, from the first such scene by day: the middle image; in traffic the
image that moving vehicles (lead truck, following van: of that kind) cover most, up to 60 %; in turns the sharpest; of
low texture the barest."""

BESIDE = """## Beside real data

Real figures are computed by the same code from real files (KITTI odometry 06; one nuScenes key frame of six
pictures; the CAN bus of four nuScenes scenes) or, for motion, taken from all 850 drives of nuScenes. **Bold** figures
lie outside their band. Motion: within {relative:.0f} % of the real figure or a small absolute difference (0.5 m/s,
0.5 deg/s, 0.15 m/s², 10 m, 10 deg, 0.05 of a share). Everything else: within the range of the real values, widened on
both sides by {widened:.0f} % of its width.
"""

PICTURES = """### Single pictures

ORB corners (FAST threshold 12) per 800 x 450 pixels; share of 6 x 10 cells without a corner; slope of the log power
spectrum over log frequency; share of the 1,500 strongest corners found again after a small known warp, darkening
and noise; share of correct matches between the two, and their median Hamming distance. Pictures of 1600 x 900 are
halved."""

PAIRS = """### Two pictures in a row

OpenCV alone: 1,500 ORB corners per 800 x 450 pixels, mutual matches with a ratio test of 0.8, and one essential
matrix by MAGSAC at 1 px. Pairs 0.1 s and 0.8 to 1.6 m apart (KITTI: 0.1 s, 1.2 m), by day. No consecutive real
pictures of side or rear cameras were at hand, so only the front camera is judged. Flow is scaled to a focal length
of 633 px."""

MOTION = """### Motion

{frames:,} written poses of {scenes} scenes. As on the real side twelve frames count as one second, and windows that
start at any frame are pooled. Each scene is dealt a path and a heading change from the real quantiles (stratified: of
n moving scenes every n-th part of the distribution gets one) and is cut where a longer drive does just that; speeds,
turning rates and accelerations within the scene come from the driver. Quantiles of single scenes rest on few values:
the outermost ones are nearly extremes. Distances are taken at the known quantiles of the real distribution."""

INTERVALS = """### Frame intervals

Real: CAM_FRONT of two scenes, key frames of ten, images per scene of 135. Nothing is judged here: the pattern is
copied on purpose."""

SENSORS = """### CAN bus

Against the 50 Hz `pose` message, as on real files, where it equals the ground truth; scenes that move at least 20
m. Noise of the gyro includes that of the pose and the vibration of the car. `leads`: the sensor is earlier than the
pose. `accel`: with gravity; wheel radius: by the `pose` speed, or from the distance between positions; spread of
radii: among the four wheels, which turning contributes to. `production` is an addition without a real counterpart."""

DIFFERENCES = """Beyond figures:

* Traffic lights stand at the corners but rule nobody. Vehicles are of four kinds and leave their lane only to pass one
  that stands in it or the island of a roundabout. People keep straight on and away from vehicles; nobody runs, pushes
  a pram or carries an umbrella.
* Streets form a bent grid on hills of at most 6 % grade, with right-hand traffic and one kind of roundabout, a small
  one with nothing painted on the road: no long tunnels or motorways, and one style of architecture. Written poses are
  flat, as those of nuScenes; pictures, wheels and the accelerometer know the slope. Houses stand level with their
  foundations in the slope.
* The lens is a pinhole without distortion (nuScenes images are undistorted as well), the shutter is global.
* In rain the road mirrors what the picture shows, vehicles throw up spray and drops stick to the glass; falling drops
  and the wiper's blade are not seen.
* Only the body's motion shakes the cameras; the rig does not bend.
* Paints, facades and vehicle shapes repeat between logs, in other places and other light.
* Two cars, whose constants vary from log to log; real fleets differ more.
"""

OUTCOMES = """## Outcomes that nobody fitted

The project's experts on {scenes} scenes by day and in rain (the paper left night out), beside the paper's figures.
The paper's come from ORB-SLAM2 on real images; its experts and ours differ, so agreement is not the aim: the
figures tell how hard this city is for the experts that are recorded here.
"""

LOST = """### Lost tracks

Per scene, mean ± standard deviation over scenes. A camera that has lost track must initialise before it can be lost
again; with instant re-initialisation every failure counts (see [metrics](metrics.md#lost-tracks))."""

YAW = """### Yaw increments

Over each camera's own image windows while it tracks, before anything is carried to the steps, against the poses at
these times without their lag (fitted from the cameras: {lags}): absolute error (median), error (RMS), slope against
the truth in turns above 5 deg/s, and the size of the error that adds up over a scene of 20 s, median and 90 % quantile
over scenes (and cameras, in the last line). The wandering of the written poses is part of it. See
[pose lag](metrics.md#pose-lag) and, for what carrying to the steps adds, [carry](metrics.md#carry)."""

BEST = """### Which camera is locally best

Eq. 2 of the paper: the camera whose yaw increment is nearest the truth, at each camera's own times against the
poses at these times without their lag; moving steps (0.2 m/s), ties split, a camera that does not track cannot be best.
Turning: above 5 deg/s. If all were equally good, each would be best in 25 %. Errors of the poses, which all cameras
share only in part, push shares towards that: their lag a little, as the column of the poses as written shows, their
wandering more. The last column uses the noise-free truth at the ends of the steps instead."""

BY_SITUATION = """### By situation

Lost tracks per scene, and the share of moving steps at which each camera is locally best."""

MOVERS = """### Matches on moving vehicles

Figure 3 of the paper shows a side view in which moving cars capture RANSAC; it gives no number. Here the simulator
knows the boxes of all vehicles that move (0.5 m/s) and are not behind houses. Pairs of consecutive images of which
movers cover at least 5 %: share of matches and of inliers inside the boxes in both images, for plain five-point
RANSAC and for the project's odometry, which knows distance, mounting and ground. Captured: more than half of the
inliers."""
