"""TOKEN: a gate for any number and kind of experts, trained on where the car ends up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mixo_env.policies.calibration import Calibration, Past
from mixo_env.policies.deepset import Layers, folded, packed, train, weigh
from mixo_env.policies.lessons import lessons
from mixo_env.policies.policy import Observation, Policy, Weights
from mixo_env.policies.storage import finite
from mixo_env.policies.tokens import SIGNALS, WHOLE, Room, Seen, blank_memory, look, read
from mixo_env.recordings.collection import Recordings

SMALLEST_STD = 1e-3
"""A signal that hardly changes in training is not blown up when it does later."""

_STRANGER = (np.inf, np.inf)


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
        epochs: int = 25,
        batch: int = 16,
        spoilt: int = 1,
        backwards: bool = False,
    ) -> None:
        """Set width, training, scenes in an update, and what is made of every training scene.

        Args:
            hidden: width of all layers but the last.
            learning_rate: of all updates.
            epochs: how often all scenes and their versions come round.
            batch: scenes in an update, at most.
            spoilt: versions with experts that drop out and break.
            backwards: also the scene in the opposite order of its steps.
        """
        self.hidden, self.learning_rate, self.epochs = hidden, learning_rate, epochs
        self.batch, self.spoilt, self.backwards = batch, spoilt, backwards
        self._known: dict[str, Sequence[float]] = {}

    def start(self, voters: Sequence[str]) -> None:
        """Take the voters; after a fit, others than those it was fitted with are strangers."""
        super().start(voters)
        self.calibration = Calibration(*np.array([self._known.get(name, _STRANGER) for name in self.experts]).T.copy())

    def fit(self, training: Recordings, track: str, *, seed: int = 0) -> None:
        """Train on scenes as they are and spoilt; same seed, same machine: same bits."""
        self.fit_beside(training, track, None, seed=seed)

    def fit_beside(
        self, training: Recordings, track: str, beside: NDArray[np.float32] | None, *, seed: int = 0
    ) -> None:
        """Train; with a companion, for the mean of both.

        Args:
            training: scenes.
            track: whose experts vote.
            beside: what the companion fuses in these scenes, ``(scenes, steps)`` in UNIT_RAD; it has no part in spoilt
                ones.
            seed: of everything random.
        """
        import torch

        experts = training.voters(track)
        self._know(experts, Calibration.fit(Past.read(training, experts)))
        super().fit(training, track)
        drawn, trained = np.random.SeedSequence(seed).generate_state(2)
        given = lessons(training, track, self, self.spoilt, int(drawn), backwards=self.backwards)
        if beside is not None:
            given.beside[: len(beside)] = beside
        x = _inputs(given.signals, given.whole)
        told = x[given.voting & given.active[..., None]]
        mean, std = told.mean(axis=0), np.maximum(told.std(axis=0), SMALLEST_STD)
        torch.set_num_threads(1)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(int(trained))
            layers = train(given, (x - mean) / std, self.hidden, self.learning_rate, self.epochs, self.batch)
        self._adopt(folded(layers, mean, std))

    def reset(self, batch: int) -> None:
        """Forget how the experts did."""
        self._memory, self._room = blank_memory(batch, len(self.experts)), Room.blank(batch, len(self.experts))

    def see(self, observation: Observation) -> Seen:
        """What becomes tokens."""
        return read(observation, self.calibration)

    def act(self, observation: Observation) -> Weights:
        """Rows ``(batch, experts)`` that sum to one; who does not vote has none."""
        tokens = look(observation, self.calibration, self._memory, self._room)
        return weigh(self.network, tokens, self._room.voting)

    def settings(self) -> dict[str, Any]:
        """Width and training."""
        names = ("hidden", "learning_rate", "epochs", "batch", "spoilt", "backwards")
        return {name: getattr(self, name) for name in names}

    def tensors(self) -> dict[str, NDArray[Any]]:
        """Calibration and network."""
        weights = {f"weight.{i}": weight for i, (weight, _) in enumerate(self._layers)}
        biases = {f"bias.{i}": bias for i, (_, bias) in enumerate(self._layers)}
        return {**self.calibration.tensors(), **weights, **biases}

    def shapes(self, inputs: int) -> dict[str, tuple[int, ...]]:
        """Calibration and the four dense layers."""
        width, h = SIGNALS + WHOLE, self.hidden
        sizes = ((width, h), (h, h), (2 * h, h), (h, 1))
        layers = {f"weight.{i}": size for i, size in enumerate(sizes)}
        biases = {f"bias.{i}": size[1:] for i, size in enumerate(sizes)}
        return {**Calibration.shapes(len(self.experts)), **layers, **biases}

    def restore(self, tensors: Mapping[str, NDArray[Any]]) -> None:
        """Take back calibration and network."""
        calibration = Calibration.restore(tensors)
        self._know(self.experts, calibration)
        self.start(self.experts)
        learned = {name: value for name, value in tensors.items() if name not in calibration.tensors()}
        values = {name: finite(name, value).astype(np.float32) for name, value in learned.items()}
        self._adopt(tuple((values[f"weight.{i}"], values[f"bias.{i}"]) for i in range(4)))

    def _adopt(self, layers: Layers) -> None:
        self._layers, self.network = layers, packed(layers)

    def _know(self, experts: Sequence[str], calibration: Calibration) -> None:
        numbers = np.stack(list(calibration.tensors().values()), axis=1)
        self._known = dict(zip(experts, numbers.tolist(), strict=True))


def _inputs(signals: NDArray[np.float32], whole: NDArray[np.float32]) -> NDArray[np.float32]:
    """``(..., experts, SIGNALS + WHOLE)``: every token with the whole step."""
    shape = (*signals.shape[:-1], whole.shape[-1])
    return np.concatenate([signals, np.broadcast_to(whole[..., None, :], shape)], axis=-1)
