"""TOKEN: a gate for any number and kind of experts, trained on where the car ends up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mixo_env.policies.deepset import Layers, corrections, weigh
from mixo_env.policies.lessons import lessons
from mixo_env.policies.policy import Observation, Policy, Weights
from mixo_env.policies.scales import usual
from mixo_env.policies.storage import finite, positive
from mixo_env.policies.tokens import SIGNALS, WHOLE, Memory, Usual, read, tokenise
from mixo_env.recordings.collection import Recordings

SMALLEST_STD = 1e-3
"""A signal that hardly changes in training is not blown up when it does later."""

_NOTHING = (np.nan, np.nan)


class Token(Policy):
    """Deep set over the experts (Zaheer et al. 2017) that corrects a Student-t consensus.

    Every expert's token passes the same two dense layers; the mean over those that vote joins each of them in two more,
    whose output is added to the logarithm of the expert's consensus weight, and a softmax over the voters follows. So
    the weights are permutation-equivariant, an untrained gate is the consensus, and experts may come, go or be
    strangers: of one that was not in the training scenes only what it does on the way is known.

    The loss is what the table counts, relative to the consensus: mean rotation error of the pieces of path per metre,
    and mean RMSE of the heading of a scene.
    """

    name = "TOKEN"
    learns = True
    any_experts: ClassVar[bool] = True

    def __init__(
        self,
        *,
        hidden: int = 16,
        learning_rate: float = 0.002,
        epochs: int = 20,
        batch: int = 16,
        spoilt: int = 1,
    ) -> None:
        """Set width, training, scenes a batch, and spoilt versions of every training scene."""
        self.hidden, self.learning_rate, self.epochs = hidden, learning_rate, epochs
        self.batch, self.spoilt = batch, spoilt
        self._known: dict[str, Sequence[float]] = {}

    def start(self, voters: Sequence[str]) -> None:
        """Take the voters; after a fit, others than those it was fitted with are strangers."""
        super().start(voters)
        self._usual = Usual(*np.array([self._known.get(name, _NOTHING) for name in self.experts]).T.copy())

    def fit(self, training: Recordings, track: str, *, seed: int = 0) -> None:
        """Train on scenes as they are, mirrored and spoilt; same seed, same machine: same bits."""
        import torch

        from mixo_env.policies.deepset import train

        experts = training.voters(track)
        measured = usual(training, experts)
        self._known = dict(zip(experts, np.stack(measured, axis=1).tolist(), strict=True))
        super().fit(training, track)
        drawn, trained = np.random.SeedSequence(seed).generate_state(2)
        given = lessons(training, track, measured, self.spoilt, int(drawn))
        x = _inputs(given.signals, given.whole)
        told = x[given.voting & given.active[..., None]]
        self._mean, self._std = told.mean(axis=0), np.maximum(told.std(axis=0), SMALLEST_STD)
        torch.set_num_threads(1)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(int(trained))
            standard = (x - self._mean) / self._std
            self._layers = train(given, standard, self.hidden, self.learning_rate, self.epochs, self.batch)

    def reset(self, batch: int) -> None:
        """Forget how the experts did."""
        self._memory = Memory.blank(batch, len(self.experts))

    def act(self, observation: Observation) -> Weights:
        """Rows ``(batch, experts)`` that sum to one; who does not vote has none."""
        seen = read(observation)
        tokens = tokenise(seen, self._usual, self._memory)
        x = (_inputs(tokens.signals, tokens.whole) - self._mean) / self._std
        return weigh(corrections(self._layers, x, seen.voting), tokens.consensus, seen.voting)

    def settings(self) -> dict[str, Any]:
        """Width and training."""
        return {name: getattr(self, name) for name in ("hidden", "learning_rate", "epochs", "batch", "spoilt")}

    def tensors(self) -> dict[str, NDArray[Any]]:
        """Scales of the experts (0: unknown), standardisation and network."""
        known = {"scale_rad": self._usual.scale_rad, "share": self._usual.share}
        weights = {f"weight.{i}": weight for i, (weight, _) in enumerate(self._layers)}
        biases = {f"bias.{i}": bias for i, (_, bias) in enumerate(self._layers)}
        scales = {name: np.nan_to_num(values, nan=0.0) for name, values in known.items()}
        return {"mean": self._mean, "std": self._std, **scales, **weights, **biases}

    def shapes(self, inputs: int) -> dict[str, tuple[int, ...]]:
        """Scales, standardisation and the four dense layers."""
        width, h, n = SIGNALS + WHOLE, self.hidden, len(self.experts)
        sizes = ((h, width), (h, h), (h, 2 * h), (1, h))
        layers = {f"weight.{i}": size for i, size in enumerate(sizes)}
        biases = {f"bias.{i}": size[:1] for i, size in enumerate(sizes)}
        return {"mean": (width,), "std": (width,), "scale_rad": (n,), "share": (n,), **layers, **biases}

    def restore(self, tensors: Mapping[str, NDArray[Any]]) -> None:
        """Take back scales, standardisation and network."""
        scales = np.stack([finite(name, tensors[name]).astype(np.float64) for name in ("scale_rad", "share")], axis=1)
        if (scales < 0.0).any():
            raise ValueError("expected scales above 0, or 0 where unknown")
        self._known = dict(zip(self.experts, np.where(scales > 0.0, scales, np.nan).tolist(), strict=True))
        self.start(self.experts)
        values = {name: finite(name, value).astype(np.float32) for name, value in tensors.items()}
        self._mean, self._std = values["mean"], positive("std", values["std"])
        self._layers: Layers = tuple((values[f"weight.{i}"], values[f"bias.{i}"]) for i in range(4))


def _inputs(signals: NDArray[np.float32], whole: NDArray[np.float32]) -> NDArray[np.float32]:
    """``(..., experts, SIGNALS + WHOLE)``: every token with the whole step."""
    shape = (*signals.shape[:-1], whole.shape[-1])
    return np.concatenate([signals, np.broadcast_to(whole[..., None, :], shape)], axis=-1)
