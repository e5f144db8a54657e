"""Pictures of an episode, drawn with OpenCV alone: no window, no display, the same picture everywhere.

Left the map, the car's first heading upwards: truth grey, estimate orange, a ring wherever fewer than half of the
cameras track (red: initialising, blue: lost). Right what the cameras see, and the experts' weights. Below the state of
every camera over the scene.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mixo_env.envs.images import SceneImages
from mixo_env.envs.replay import Replay
from mixo_env.experts.expert import State
from mixo_env.recordings.collection import Recordings

Image = NDArray[np.uint8]
Colour = tuple[int, int, int]

HEIGHT, WIDTH = 540, 960
MAP = (16, 16, 500, 400)  # x, y, width, height [px]
TILES = (532, 16, 206, 116)  # of the first camera; the others follow in two columns
BARS = (532, 270, 412, 146)
STRIP = (116, 446, 828, 78)

WHITE: Colour = (255, 255, 255)
INK: Colour = (40, 44, 52)
FAINT: Colour = (214, 218, 224)
TRUTH: Colour = (140, 146, 156)
ESTIMATE: Colour = (226, 110, 20)
BAR: Colour = (76, 120, 168)
STATES: dict[int, Colour] = {
    State.TRACKING: (122, 178, 120),
    State.INITIALISING: (214, 69, 65),
    State.LOST: (52, 101, 205),
    State.NO_IMAGE: (205, 205, 205),
}


class Scenery(Protocol):
    """What a picture is drawn of: a session, or a policy that is played without an environment."""

    @property
    def recordings(self) -> Recordings:
        """The scenes."""
        ...

    @property
    def replay(self) -> Replay:
        """Where the batch stands in them."""
        ...

    @property
    def weights(self) -> NDArray[np.float64]:
        """``(batch, experts)`` of the last step."""
        ...

    @property
    def images(self) -> SceneImages | None:
        """Of the cameras, where they are at hand."""
        ...


def describe(session: Scenery, entry: int) -> str:
    """One line about a batch entry: ``render_mode="ansi"``."""
    replay, state = session.replay, session.replay.state[entry]
    scene = session.recordings.scenes[state["scene"]].name
    time_s = session.recordings.rows(int(state["scene"]))["time_s"][int(state["step"])]
    weights = ", ".join(f"{name} {w:.2f}" for name, w in zip(replay.experts, session.weights[entry], strict=True))
    return (
        f"{scene} step {state['step']}/{replay.steps[state['scene']]} {time_s:5.2f} s | "
        f"yaw error {np.rad2deg(state['error_rad']):+.3f} deg | "
        f"position error {np.sqrt(state['position_error_m2']):.2f} m | {weights}"
    )


def draw(session: Scenery, entry: int) -> Image:
    """A frame ``(540, 960, 3)`` RGB of a batch entry: ``render_mode="rgb_array"``."""
    canvas = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)
    draw_map(canvas, session, entry)
    draw_tiles(canvas, session, entry)
    draw_weights(canvas, session, entry)
    draw_states(canvas, session, entry)
    return canvas


def draw_map(canvas: Image, session: Scenery, entry: int) -> None:
    """Truth and estimate from above."""
    import cv2

    replay, state = session.replay, session.replay.state[entry]
    left, top, width, height = MAP
    cv2.rectangle(canvas, (left, top), (left + width, top + height), FAINT, 1)
    truth = replay.true_trajectory(int(state["scene"]))
    x0, y0, yaw0 = (float(values[0]) for values in truth)
    heading = np.exp(-1j * (yaw0 - np.pi / 2))

    def turned(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.complex128]:
        return (x - x0 + 1j * (y - y0)) * heading

    path = turned(truth[0], truth[1])
    extent = max(np.ptp(path.real) / (width - 60), np.ptp(path.imag) / (height - 130), 20.0 / (height - 130))  # [m/px]
    centre = complex(path.real.max() + path.real.min(), path.imag.max() + path.imag.min()) / 2

    def pixels(z: NDArray[np.complex128]) -> NDArray[np.int32]:
        """In sixteenths of a pixel, which is how OpenCV draws smoothly."""
        z = (z - centre) / extent
        xy = np.stack([width / 2 + z.real, height / 2 + 15 - z.imag], axis=-1)
        return np.round(16 * np.clip(xy, -2000, 4000)).astype(np.int32)

    window = canvas[top : top + height, left : left + width]  # a wild estimate may leave the map, not cover the rest
    done = int(state["step"])
    estimate = turned(*replay.trajectory(entry)[:2])
    cv2.polylines(window, [pixels(path)], False, FAINT, 5, cv2.LINE_AA, 4)
    cv2.polylines(window, [pixels(path[: done + 1])], False, TRUTH, 5, cv2.LINE_AA, 4)
    cv2.polylines(window, [pixels(estimate)], False, ESTIMATE, 2, cv2.LINE_AA, 4)
    states = camera_states(session, int(state["scene"]))
    poor = np.mean(states == State.TRACKING, axis=1) < 0.5 if states.shape[1] else np.zeros(len(states), bool)
    for k in np.flatnonzero(poor[: done + 1]):
        lost = np.mean(states[k] == State.LOST) >= np.mean(states[k] == State.INITIALISING)
        x, y = pixels(estimate[k : k + 1])[0].tolist()
        cv2.circle(window, (x, y), 16 * 4, STATES[State.LOST if lost else State.INITIALISING], 1, cv2.LINE_AA, 4)
    for z, colour in ((path[done : done + 1], TRUTH), (estimate[-1:], ESTIMATE)):
        x, y = pixels(z)[0].tolist()
        cv2.circle(window, (x, y), 16 * 5, colour, -1, cv2.LINE_AA, 4)
    metres = float(10 ** np.floor(np.log10(100 * extent)))
    metres *= 5 if 5 * metres / extent < 140 else 2 if 2 * metres / extent < 140 else 1
    bar = round(metres / extent)
    cv2.line(canvas, (left + 14, top + height - 14), (left + 14 + bar, top + height - 14), INK, 2)
    write(canvas, f"{metres:g} m", (left + 20 + bar, top + height - 10))
    for i, (name, colour) in enumerate((("truth", TRUTH), ("estimate", ESTIMATE))):
        x, y = left + width - 170 + 70 * i, top + height - 14
        cv2.line(canvas, (x, y), (x + 16, y), colour, 3)
        write(canvas, name, (x + 22, y + 4))
    scene = session.recordings.scenes[state["scene"]]
    write(canvas, f"{scene.name}  {', '.join(scene.conditions)}", (left + 12, top + 22), 0.5)
    error = (
        f"position {np.sqrt(state['position_error_m2']):.2f} m, yaw {np.rad2deg(yaw_error(session, entry)):+.2f} deg"
    )
    write(canvas, f"step {done}/{replay.steps[state['scene']]}   error: {error}", (left + 12, top + 42))


def yaw_error(session: Scenery, entry: int) -> float:
    """Fused minus true yaw [rad] of a batch entry."""
    state = session.replay.state[entry]
    _, _, yaw = session.replay.true_trajectory(int(state["scene"]))
    return float(state["yaw_rad"] - (yaw[int(state["step"])] - yaw[0]))


def camera_states(session: Scenery, scene: int) -> NDArray[np.int8]:
    """State ``(rows, cameras)`` of every camera over a scene."""
    rows = session.recordings.rows(scene)
    return np.stack([rows[f"{camera}.state"] for camera in session.replay.cameras] or [rows["step"][:0]], axis=-1)


def draw_tiles(canvas: Image, session: Scenery, entry: int) -> None:
    """Camera images where they are at hand, else what the cameras report."""
    import cv2

    replay, state = session.replay, session.replay.state[entry]
    scene, row = int(state["scene"]), replay.recording_row(entry)
    left, top, width, height = TILES
    paths = session.images.paths(scene, row) if session.images else {}
    columns = session.recordings.rows(scene)
    for c, camera in enumerate(replay.cameras[:4]):
        x, y = left + (c % 2) * width, top + (c // 2) * (height + 6)
        awake = replay.awake_cameras(entry)[c]
        colour = STATES[int(columns[f"{camera}.state"][row]) if awake else State.NO_IMAGE]
        if session.images:
            picture = session.images.read(paths[camera], (height, width - 6, 3))
            canvas[y : y + height, x : x + width - 6] = picture if awake else picture // 4 + 160
            cv2.rectangle(canvas, (x, y), (x + 92, y + 16), WHITE, -1)
        else:
            matches = np.nan_to_num(columns[f"{camera}.matches"][row])
            write(canvas, f"{matches:.0f} matches" if awake else "asleep", (x + 10, y + 60), 0.6)
        write(canvas, camera[4:].lower().replace("_", " "), (x + 6, y + 12))
        cv2.rectangle(canvas, (x, y), (x + width - 7, y + height - 1), colour, 2)


def draw_weights(canvas: Image, session: Scenery, entry: int) -> None:
    """A bar for every expert's weight in the last step."""
    import cv2

    left, top, width, height = BARS
    experts = session.replay.experts
    pitch = min(height // len(experts), 26)
    zero, unit = left + 150, (width - 200)
    for j, (expert, weight) in enumerate(zip(experts, session.weights[entry], strict=True)):
        y = top + j * pitch
        end = zero + round(float(np.clip(weight, -0.2, 1.15)) * unit)
        cv2.rectangle(canvas, (min(zero, end), y), (max(zero, end), y + pitch - 6), BAR, -1)
        write(canvas, expert, (left, y + pitch - 9))
        write(canvas, f"{weight:.2f}", (max(zero, end) + 6, y + pitch - 9))
    cv2.line(canvas, (zero, top - 4), (zero, top + len(experts) * pitch), INK, 1)


def draw_states(canvas: Image, session: Scenery, entry: int) -> None:
    """A strip per camera: its state over the whole scene, and where we are."""
    import cv2

    state = session.replay.state[entry]
    states = camera_states(session, int(state["scene"]))
    left, top, width, height = STRIP
    cameras = session.replay.cameras
    pitch = height // max(len(cameras), 1)
    palette = np.array([STATES[code] for code in sorted(STATES)], np.uint8)
    shown = np.arange(width) * len(states) // width
    for c, camera in enumerate(cameras):
        canvas[top + c * pitch : top + (c + 1) * pitch - 3, left : left + width] = palette[states[shown, c]]
        write(canvas, camera[4:].lower().replace("_", " "), (16, top + c * pitch + pitch // 2 + 3))
    x = left + int(state["step"]) * width // len(states)
    cv2.line(canvas, (x, top - 5), (x, top + height), INK, 2)
    legend: list[tuple[str, Any]] = [("tracking", 1), ("initialising", 0), ("lost", 2), ("no image", 3)]
    for i, (name, code) in enumerate(legend):
        cv2.rectangle(canvas, (left + i * 110, top - 18), (left + i * 110 + 10, top - 8), STATES[code], -1)
        write(canvas, name, (left + i * 110 + 16, top - 9))


def write(canvas: Image, text: str, origin: tuple[int, int], size: float = 0.4) -> None:
    """Text with its lower left corner at ``origin`` [px]."""
    import cv2

    cv2.putText(canvas, text, origin, cv2.FONT_HERSHEY_SIMPLEX, size, INK, 1, cv2.LINE_AA)
