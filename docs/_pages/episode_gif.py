"""Draw docs/figures/episode.gif: a policy plays one scene of the bundled recordings.

    python -m docs._pages.episode_gif --dataroot FOLDER

Without ``--dataroot`` the cameras' tiles show their match counts instead of their images; the images of ``mixocity``
are made again by ``make mixocity``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from mixo_env.files import atomic_path


@dataclass(frozen=True)
class EpisodeGif:
    """Draw one episode."""

    out: Path = Path("docs/figures/episode.gif")
    """File to write."""
    dataroot: Path | None = None
    """The nuScenes folder that was recorded."""
    recordings: Path | None = None
    """Folder of the recordings; default: the bundled ones."""
    scene: str = "scene-2248"
    """Scene to play, of the held-out fold."""
    policy: str = "MIXO"
    """Policy to play it, fitted on the training folds."""
    every: int = 5
    """Steps between frames."""
    width: int = 640
    """Width of the picture [px]; its height is 9/16 of it."""
    colours: int = 48
    """Size of the palette: what keeps the file small."""

    def run(self) -> int:
        """Play and write."""
        from PIL import Image

        from mixo_env.envs import rendering

        env: Any = gym.make(
            "mixo_env:MixoOdometry-v0",
            recordings=self.recordings,
            dataroot=self.dataroot,
            split="test",
            observation="dict",
            weights="raw",
            render_mode="rgb_array",
        )
        size = self.width, self.width * 9 // 16
        pictures = [
            Image.fromarray(self._named(frame)).resize(size, Image.Resampling.LANCZOS) for frame in self._frames(env)
        ]
        drawing = [rendering.WHITE, rendering.INK, rendering.ESTIMATE, rendering.BAR, *rendering.STATES.values()]
        street = pictures[len(pictures) // 2].quantize(self.colours - len(drawing)).getpalette() or []
        palette = Image.new("P", (1, 1))
        palette.putpalette([value for colour in drawing for value in colour] + street)
        drawn = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
        pause_ms = round(1000 * self.every / env.metadata["render_fps"] / 4)  # four times as fast as driven
        moving: dict[str, Any] = {
            "save_all": True,
            "append_images": drawn[1:],
            "duration": pause_ms,
            "loop": 0,
            "optimize": True,
        }
        with atomic_path(self.out) as temporary:
            drawn[0].save(temporary, format="GIF", **moving)
        print(f"wrote {self.out}: {len(drawn)} frames, {self.out.stat().st_size / 1024:.0f} KiB")
        return 0

    def _named(self, frame: np.ndarray) -> np.ndarray:
        """A frame that says, above the bars, whose weights these are."""
        from mixo_env.envs import rendering

        left, top, *_ = rendering.BARS
        rendering.write(frame, f"weights of {self.policy}", (left, top - 5), 0.45)
        return frame

    def _frames(self, env: Any) -> list[np.ndarray]:
        from mixo_env.policies.fitting import prepare
        from mixo_env.policies.registry import create
        from mixo_env.recordings.store import load_recordings

        recordings = load_recordings(self.recordings)
        settings = env.unwrapped.session.settings
        policy = create(self.policy, recordings)
        prepare(policy, recordings.select(split="train"), settings.track)
        policy.reset(1)
        observation, _ = env.reset(seed=0, options={"scene": self.scene})
        frames, truncated, step = [], False, 0
        while not truncated:
            weights = policy.act({name: values[None] for name, values in observation.items()})
            observation, _, _, truncated, _ = env.step(np.float32(weights[0] / settings.raw_scale))
            step += 1
            if step % self.every == 0 or truncated:
                frames.append(env.render())
        return frames


if __name__ == "__main__":
    import tyro

    raise SystemExit(tyro.cli(EpisodeGif).run())
