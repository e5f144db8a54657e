"""``MixoOdometry-v0``: the single and the batched environment over one fusion core."""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from mixo_env.envs.making import RENDER_MODES, PlainSpec, checked_autoreset_mode, checked_count, checked_render_mode
from mixo_env.envs.session import Session
from mixo_env.envs.settings import Settings
from mixo_env.envs.stepping import REPORT
from mixo_env.errors import ConfigurationError


class MixoOdometryEnv(PlainSpec, gym.Env[Any, Any]):  # pyright: ignore[reportIncompatibleVariableOverride]
    """Decide, image by image, how much to trust each camera of a car's rig.

    ## Description
    Several experts - odometries of single cameras, and usually an inertial one - report by how much the car has turned
    since the last step. The agent weights them; the weighted turn (eq. 3) is added to the car's yaw (eq. 4), the
    distance from the wheels moves it along (eq. 1), and the closer the turn was to the truth, the better. An episode is
    one recorded drive of about 20 s at about 12 steps a second. Experts ran when the scene was recorded and are
    replayed exactly: no image is processed here.

    The game is nearly a contextual bandit: an action moves the estimate, but of what comes next it changes only the
    observed previous yaw rate. A discount factor of 0 is a good start.

    ## Action space
    `Box(-1, 1, (N,), float32)` for N experts in the order of `env.unwrapped.session.replay.experts`; with
    `weights="select"` `Discrete(N)`. What the numbers mean is the option `weights`:

    | `weights` | the experts' weights |
    |---|---|
    | `"softmax"` | softmax of 5 x action: positive, sum 1 (the paper's gate) |
    | `"simplex"` | the nearest point to the action with weights >= 0 and sum 1 |
    | `"raw"` | `raw_scale` x action: any sign, any sum |
    | `"select"` | 1 for the chosen expert |

    NaN, numbers outside [-1, 1], another shape or dtype raise `ConfigurationError` and change nothing.

    ## Observation space
    `observation="paper"` (default) is a flat float32 `Box` of the first four rows: x_k of the paper, then what the
    experts say. `"rich"` is all rows. `"dict"` is all rows by name, one level deep. `"pixels"` (needs `dataroot`) is
    `{"state": the paper's Box, camera: uint8 (64, 112, 3) image of this step}`. C is the number of cameras.

    | name | width | range | unit | meaning |
    |---|---|---|---|---|
    | `previous_yaw_rate` | 1 | -3.1416 to 3.1416 | rad/s | yaw rate over the previous step, see `previous` |
    | `speed` | 1 | -60 to 60 | m/s | longitudinal speed at the end of the previous step |
    | `matches` | C | 0 to 10000 | count | matched features, 0 unless the camera is tracking |
    | `yaw_rates` | N | -3.1416 to 3.1416 | rad/s | yaw rate over this step, substituted if lost |
    | `dt` | 1 | 0 to 1 | s | duration of this step |
    | `available` | N | 0 to 1 | 0 or 1 | the expert delivered an increment of its own |
    | `inliers` | C | 0 to 10000 | count | estimate: share of matches solved with that agree with motion, times all |
    | `residual_px` | C | 0 to 100 | px | median reprojection residual of the inliers |
    | `flow_px` | C | 0 to 2000 | px | median displacement of the matches |
    | `state` | C | 0 to 3 | code | 0 initialising, 1 tracking, 2 lost, 3 no image |
    | `yaw_rate_std` | N | 0 to 3.1416 | rad/s | the expert's own standard deviation |
    | `disagreement` | N | -6.2832 to 6.2832 | rad/s | yaw rate minus the median of those available |

    All of it is known when the step closes, nothing later. What is missing is 0, with `available` 0. Values are clipped
    to their range. `speed` and `previous_yaw_rate` belong to the step before; in the first step the inertial yaw rate
    of that step stands in for the previous one. After the last step nothing follows: the observation is the last one
    again, with the new previous yaw rate. Ground truth is in no observation, unless asked for by name:
    `previous="truth"`, or `privileged=True`, which appends `truth_yaw_rate`.

    ## Reward
    With the error e of the fused yaw increment, in units of sigma_0 (1.4826 x median absolute deviation of the error of
    LINEAR, the best constant weights, on this track; imported experts: 0.05 deg) and capped at 10 units:

    | `reward` | per step | terms in `info` |
    |---|---|---|
    | `"squared"` | -e^2 | `reward_yaw` |
    | `"abs"` | -abs(e) | `reward_yaw` |
    | `"improvement"` | LINEAR's e^2 - e^2; LINEAR fitted outside the held-out fold | `reward_yaw`, `reward_linear` |
    | `"pose"` | -d^2, d = distance from the true position [m], capped at 10 | `reward_position` |

    ## Starting state
    A scene drawn at random (`order="random"`) or the next one of the split (`order="fixed"`, from the first after every
    seeded reset: a pass for evaluation), or the one asked for by `reset(options={"scene": name})`. The first pose is
    the true one.

    ## Episode end
    `truncated` is True after the scene's last step; `terminated` never is: nothing the agent does ends a drive.

    ## Info
    Every step: `yaw_increment_rad` (fused), `yaw_error_rad` (fused minus true), the reward's terms, with `dataroot`
    `images`, the path of every camera's image of the step to be decided next, and where an expert fails `faults`: its
    name -> the kinds of its faults in that step, "" while it is sound. Reset: `scene`. Last step: `ate_m`,
    `ate_deg` (RMSE of position and yaw over all poses, not aligned) and `yaw_rmse_deg` (of the increments), so that
    `Monitor(env, info_keywords=("ate_m",))` logs them, and `scores`, the same with `scene`.

    ## Arguments
    | option | default | meaning |
    |---|---|---|
    | `recordings` | `None` | folder or name of recordings, or a `Recordings`; `None`: the bundled `mixocity` |
    | `track` | `"CONSUMER"` | who votes: `"PAPER"`, `"VISION"` (cameras alone), `"CONSUMER"`, `"UNEQUAL"`; see below |
    | `split` | `"train"` | `"train"`: all folds but `fold`; `"test"`: that fold; `"all"`: both; `"ood"`: night |
    | `fold` | `3` | the fold held out |
    | `conditions` | `None` | only scenes that show all of these, a list of `"day"`, `"night"` and `"rain"` |
    | `experts` | `None` | two or more voters of the track, in the order of the weights |
    | `observation` | `"paper"` | see above |
    | `privileged` | `False` | append the true yaw rate to the observation |
    | `weights`, `raw_scale` | `"softmax"`, `4.0` | see above |
    | `previous` | `"fused"` | previous yaw rate: the fused one, `"inertial"`, or `"truth"` (privileged: for training) |
    | `lost` | `"inertial"` | lost experts vote with the track's inertial increment, or `"mask"`: they do not vote |
    | `reward` | `"squared"` | see above |
    | `order` | `"random"` | see above |
    | `faults` | `()` | faults to inject, see below |
    | `dataroot` | `None` | the nuScenes folder that was recorded, for `images` and `"pixels"` |
    | `render_mode` | `None` | `"ansi"`: one line; `"rgb_array"`: a frame of 540 x 960, drawn without a display |

    Tracks are never compared with each other. In `"UNEQUAL"` experts of other families (TUTORIAL, ORBSLAM3, LEARNED,
    one a camera) vote beside the cameras' own odometry; recordings that hold none of them cannot play it.

    An unknown option or value and one of the wrong type raise `ConfigurationError`, which names what is valid. With
    `lost="mask"` the other experts share the weight of the masked ones (`"raw"`: they do not); where nobody votes, the
    inertial increment bridges. Recordings from a folder are read once a process and shared, read only, by all its
    environments; those of equal options share their tables too.

    A fault is a `mixo_env.envs.faults.Fault` or a dict of its fields: `expert`, `kind`, and where they differ from the
    defaults `start_step` (1), `noise_radps` (0.05), `delay_steps` (1).

    | `kind` | from `start_step` of every scene on the expert |
    |---|---|
    | `"stuck"` | repeats the yaw rate before the fault |
    | `"flipped"` | has the wrong sign |
    | `"noisy"` | has white noise of `noise_radps` added to its yaw rate |
    | `"delayed"` | says what it should have said `delay_steps` earlier |
    | `"dropped"` | says nothing; a camera is lost |

    Faults change what is observed, never the truth, and `info["faults"]` names them - as it names those of the cameras'
    pictures, if the recordings were made of a simulated folder with some (`mixo simulate --fault.kind`).

    ## Vectorised use
    `gymnasium.make_vec("mixo_env:MixoOdometry-v0", num_envs=1024)` steps all scenes in one compiled loop and equals the
    single environment step for step. It takes the same options, `max_episode_steps` (as `gymnasium.make` does) and
    `autoreset_mode` (`"NEXT_STEP"`, `"SAME_STEP"`, or `"DISABLED"` with `reset(options={"reset_mask": mask})`). The
    prefix `mixo_env:` imports the package, which registers the environments; worker processes need it too.
    Stable-Baselines3 takes `mixo_env.envs.sb3.MixoVecEnv`; TorchRL takes `GymEnv("mixo_env:MixoOdometry-v0")` and, in
    batches, `GymWrapper(gymnasium.make_vec(..., autoreset_mode="DISABLED"))`.

    ```python
    import gymnasium as gym

    env = gym.make("mixo_env:MixoOdometry-v0")
    observation, info = env.reset(seed=0)
    truncated = False
    while not truncated:
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
    print(info["scores"])
    ```

    Episodes of any policy become a Minari data set, for offline reinforcement learning, by
    `mixo_env.envs.episodes.write_minari`: see `examples/minari_episodes.py`.

    ## Version history
    * v0: first version. Scores may move until release 1.0.0; until then quote the data version of the recordings.
    """

    metadata: dict[str, Any] = {"render_modes": RENDER_MODES, "render_fps": 12}  # noqa: RUF012 (typed by Gymnasium)
    session_class: ClassVar[type[Session]] = Session
    settings_class: ClassVar[type[Settings]] = Settings

    def __init__(self, *, render_mode: str | None = None, **options: Any) -> None:
        """Build the environment; see the class for the options."""
        self.render_mode = checked_render_mode(render_mode)
        settings = self.settings_class.read(options)
        self.session = self.session_class(settings, 1, keep_trajectories=render_mode is not None)
        self.observation_space = self.session.observation_space
        self.action_space = self.session.rule.space
        self._ended = True

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start a scene: a random one, the next one (``order="fixed"``) or ``options={"scene": name}``."""
        asked = self.session.asked(options, 1)
        super().reset(seed=seed)
        if seed is not None:
            self.session.rewind()
        self.session.begin(np.arange(1), self.np_random, asked)
        self._ended = False
        return entry(self.session.observe(), 0), {"scene": self._scene()} | self._coming_info()

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Weigh the experts for one step."""
        if self._ended:
            raise ConfigurationError("the scene has ended: call reset() before step()")
        session = self.session
        observation, report, ended = session.step(session.rule.read(action, None))
        reward, increment, error, *terms = report.ravel().tolist()
        info: dict[str, Any] = {"yaw_increment_rad": increment, "yaw_error_rad": error}
        for name, term in zip(session.terms, terms, strict=True):
            info[name] = term
        self._ended = ended > 0
        if self._ended:
            scores = {name: float(values[0]) for name, values in session.replay.scores().items()}
            info |= scores | {"scores": {"scene": self._scene(), **scores}}
        if session.images or session.faulty:
            info |= self._coming_info()
        return entry(observation, 0), reward, False, self._ended, info

    def render(self) -> Any:
        """A line (``"ansi"``) or a frame ``(540, 960, 3)`` RGB (``"rgb_array"``) about the scene as it stands."""
        return rendered(self, self.session)[0] if self.render_mode else None

    def _scene(self) -> str:
        return self.session.scene_names(np.ones(1, np.bool_))[0]

    def _coming_info(self) -> dict[str, Any]:
        """Images and faults of the step to be decided next."""
        paths, faults = self.session.image_paths(0), self.session.faults()
        info: dict[str, Any] = {}
        if paths:
            info["images"] = {camera: path and str(path) for camera, path in paths.items()}
        if faults:
            info["faults"] = {expert: names[0] for expert, names in faults.items()}
        return info


class MixoOdometryVectorEnv(PlainSpec, VectorEnv[Any, Any, Any]):  # pyright: ignore[reportIncompatibleVariableOverride]
    """``num_envs`` copies of :class:`MixoOdometryEnv` stepped together; equal to it step for step, and much faster."""

    metadata: dict[str, Any] = {  # noqa: RUF012 (typed by Gymnasium)
        "render_modes": RENDER_MODES,
        "render_fps": 12,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }
    session_class: ClassVar[type[Session]] = Session
    settings_class: ClassVar[type[Settings]] = Settings

    def __init__(
        self,
        num_envs: int = 1,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
        **options: Any,
    ) -> None:
        """Build the environments; see :class:`MixoOdometryEnv` for the options.

        ``max_episode_steps`` truncates a scene early, as Gymnasium's wrapper ``TimeLimit`` does for single ones.
        """
        self.render_mode = checked_render_mode(render_mode)
        self.autoreset_mode = checked_autoreset_mode(autoreset_mode)
        self.metadata = {**type(self).metadata, "autoreset_mode": self.autoreset_mode}
        self.num_envs = checked_count("num_envs", num_envs)
        self._limit = None if max_episode_steps is None else checked_count("max_episode_steps", max_episode_steps)
        settings = self.settings_class.read(options)
        self.session = self.session_class(settings, self.num_envs, keep_trajectories=render_mode is not None)
        self.single_observation_space = self.session.observation_space
        self.single_action_space = self.session.rule.space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._ended, self._any_ended, self._begun = np.ones(self.num_envs, np.bool_), True, False

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start all scenes, or with ``options={"reset_mask": (num_envs,) bool}`` some of them.

        ``options={"scene": name}`` or a list of names, one per environment that is reset, chooses the scenes.
        """
        mask = self._reset_mask(options)
        asked = self.session.asked(options, int(mask.sum()))
        super().reset(seed=seed)
        if seed is not None:
            self.session.rewind()
        self.session.begin(np.flatnonzero(mask), self.np_random, asked)
        self._ended &= ~mask
        self._any_ended = bool(self._ended.any())
        self._begun = True
        return self.session.observe(), self._reset_info(mask) | self._coming_info(mask)

    def step(
        self, actions: Any
    ) -> tuple[Any, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Weigh the experts for one step everywhere; what follows the end of a scene is the autoreset mode's affair."""
        session, mode, before = self.session, self.autoreset_mode, self._ended
        numbers = session.rule.read(actions, self.num_envs)
        info: dict[str, Any] = {}
        played = np.ones(self.num_envs, np.bool_)
        if self._any_ended:
            if mode is not AutoresetMode.NEXT_STEP or not self._begun:
                raise ConfigurationError(f"{before.sum()} scenes have ended or never begun: reset them first")
            session.rule.complain(numbers)
            session.begin(np.flatnonzero(before), self.np_random, pause=True)  # NEXT_STEP: this step is their reset
            info, played = self._reset_info(before), ~before
        observation, report, ended = session.step(numbers)
        truncated = session.replay.done.copy()
        if self._limit is not None:
            truncated |= session.replay.state["step"] >= self._limit
            ended = int(truncated.sum())
        reward = report[0]
        told = dict(zip(REPORT[1:] + session.terms, report[1:], strict=True))
        if ended and mode is AutoresetMode.SAME_STEP:
            info |= {"final_obs": self._listed(observation, truncated), "_final_obs": truncated.copy()}
            final = only(told, truncated) | self._scores(truncated) | self._coming_info(truncated)
            info |= {"final_info": final, "_final_info": truncated.copy()}
            session.begin(np.flatnonzero(truncated), self.np_random)
            observation = session.observe()
            info |= self._reset_info(truncated) | only(told, ~truncated)
        else:
            if not self._any_ended or played.any():
                info |= masked(told, played)
            if ended:
                info |= self._scores(truncated)
            self._ended, self._any_ended = truncated.copy(), ended > 0
        if session.images or session.faulty:
            info |= self._coming_info(np.ones(self.num_envs, np.bool_))
        return observation, reward, np.zeros(self.num_envs, np.bool_), truncated, info

    def render(self) -> tuple[Any, ...] | None:
        """One line or frame per environment, see :meth:`MixoOdometryEnv.render`."""
        return rendered(self, self.session) if self.render_mode else None

    def _reset_mask(self, options: dict[str, Any] | None) -> NDArray[np.bool_]:
        mask = options.get("reset_mask") if isinstance(options, dict) else None
        if mask is None:
            return np.ones(self.num_envs, np.bool_)
        if not isinstance(mask, np.ndarray) or mask.shape != (self.num_envs,) or mask.dtype != np.bool_:
            raise ConfigurationError(f"reset_mask: expected a bool array of shape ({self.num_envs},), got {mask!r}")
        if not mask.any():
            raise ConfigurationError("reset_mask: expected at least one True, got none: nothing would be reset")
        return mask

    def _reset_info(self, mask: NDArray[np.bool_]) -> dict[str, Any]:
        return {"scene": self.session.scene_names(mask), "_scene": mask.copy()}

    def _scores(self, truncated: NDArray[np.bool_]) -> dict[str, Any]:
        """Scores of the scenes that have ended, flat for monitors and together under ``scores``."""
        mask = truncated & self.session.replay.done
        if not mask.any():
            return {}
        scores = self.session.replay.scores()
        named = {"scene": self.session.scene_names(mask), **scores}
        return masked(scores, mask) | {"scores": masked(named, mask), "_scores": mask}

    def _coming_info(self, mask: NDArray[np.bool_]) -> dict[str, Any]:
        """Images and faults of the steps to be decided next, where ``mask`` is True."""
        info: dict[str, Any] = {}
        if self.session.images:
            images: dict[str, Any] = {c: np.full(self.num_envs, None, object) for c in self.session.images.cameras}
            for i in np.flatnonzero(mask).tolist():
                for camera, path in self.session.image_paths(i).items():
                    images[camera][i] = path and str(path)
            info |= {"images": masked(images, mask.copy()), "_images": mask.copy()}
        if faults := self.session.faults():
            nothing = np.full(self.num_envs, None, object)
            told = {expert: np.where(mask, names, nothing) for expert, names in faults.items()}
            info |= {"faults": masked(told, mask.copy()), "_faults": mask.copy()}
        return info

    def _listed(self, observation: Any, truncated: NDArray[np.bool_]) -> NDArray[Any]:
        """Observations of the scenes that ended, one by one in an object array (Gymnasium's ``final_obs``)."""
        listed = np.full(self.num_envs, None, dtype=object)
        for i in np.flatnonzero(truncated).tolist():
            listed[i] = entry(observation, i)
        return listed


def rendered(env: MixoOdometryEnv | MixoOdometryVectorEnv, session: Session) -> tuple[Any, ...]:
    """What every scene of the batch looks like in the environment's render mode."""
    from mixo_env.envs import rendering

    show = rendering.describe if env.render_mode == "ansi" else rendering.draw
    return tuple(show(session, i) for i in range(session.replay.batch))


def entry(observation: Any, i: int) -> Any:
    """Observation of one environment of a batch."""
    if isinstance(observation, dict):
        return {name: values[i] for name, values in observation.items()}
    return observation[i]


def masked(values: dict[str, NDArray[Any]], mask: NDArray[np.bool_]) -> dict[str, Any]:
    """Gymnasium's form of batched information: beside each array, 0 where it does not apply, a mask ``_name``."""
    return {key: item for name, array in values.items() for key, item in ((name, array), (f"_{name}", mask))}


def only(values: dict[str, NDArray[Any]], mask: NDArray[np.bool_]) -> dict[str, Any]:
    """The same of ``values`` that apply only where ``mask`` is True; nothing at all if that is nowhere."""
    return masked({name: np.where(mask, array, 0.0) for name, array in values.items()}, mask) if mask.any() else {}
