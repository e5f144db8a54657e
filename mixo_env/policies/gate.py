"""MIXO: the paper's gate, a small network that weights the experts by driving state and match counts (eqs. 3 and 5)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.fusion import softmax
from mixo_env.policies.linear import Linear
from mixo_env.policies.playing import collect
from mixo_env.policies.policy import Observation, Policy, Weights
from mixo_env.policies.storage import check_inputs, finite, positive
from mixo_env.recordings.collection import Recordings

if TYPE_CHECKING:
    from torch import nn


_PLACES = (0, 3, 6)
"""Of the dense layers in the network; rectified units and dropout lie between them. A linear gate has but the first."""


class Mixo(Policy):
    """Softmax gate on x_k = (previous yaw rate, previous speed, matches of every camera), standardised.

    Two hidden layers with dropout, Adam with learning rate eta(t) = eta0 alpha^(t / t0), mean squared error of the yaw
    rate. The defaults are the paper's best grid point; what the paper leaves open is decided as follows.

    * t0 is the number of updates of the whole training, so the rate ends at alpha x eta0.
    * Batch 1024; ``epochs`` passes, or as many as make ``min_updates`` updates when the training set is small.
    * The previous yaw rate is the fused one, as in a deployed system; while training it is LINEAR's, fitted on the same
      scenes, so that its errors look like those met later.
    * Rectified linear units, Xavier initialisation, loss in deg/s.
    """

    name = "MIXO"
    learns = True

    def __init__(
        self,
        *,
        hidden: tuple[int, int] = (16, 16),
        dropout: tuple[float, float] = (0.1, 0.1),
        learning_rate: float = 0.02,
        decay: float = 0.05,
        batch: int = 1024,
        epochs: int = 10,
        min_updates: int = 400,
    ) -> None:
        """Set the paper's N1 N2, d1 d2, eta0 and alpha, then what it leaves open."""
        self.hidden, self.dropout = tuple(hidden), tuple(dropout)
        self.learning_rate, self.decay = learning_rate, decay
        self.batch, self.epochs, self.min_updates = batch, epochs, min_updates

    def fit(self, training: Recordings, track: str, *, seed: int = 0) -> None:
        """Train on all steps of ``training``; same seed, same machine: same bits."""
        import torch

        super().fit(training, track)
        linear = Linear()
        linear.fit(training, track)
        samples = collect(training, track, linear)
        x = gate_input(samples)
        self._mean, self._std = x.mean(axis=0), x.std(axis=0)
        self._std[self._std == 0.0] = 1.0

        torch.set_num_threads(1)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            network = self._build(x.shape[1], len(self.experts))
            self._train(
                network,
                torch.from_numpy((x - self._mean) / self._std),
                torch.from_numpy(np.degrees(samples["yaw_rates"])),
                torch.from_numpy(np.degrees(samples["truth_yaw_rate"][:, 0])),
            )
        # Deciding needs neither torch nor dropout: plain matrices take a tenth of the time for one scene.
        dense = [layer for layer in network if isinstance(layer, torch.nn.Linear)]
        self._layers = [(x.weight.detach().numpy().copy(), x.bias.detach().numpy().copy()) for x in dense]

    def act(self, observation: Observation) -> Weights:
        """Softmax rows ``(batch, experts)``."""
        x = (check_inputs(self.name, gate_input(observation), self._mean) - self._mean) / self._std
        for weight, bias in self._layers[:-1]:
            x = np.maximum(x @ weight.T + bias, 0.0)
        weight, bias = self._layers[-1]
        return softmax(x @ weight.T + bias)

    def settings(self) -> dict[str, Any]:
        """Architecture and training."""
        names = ("hidden", "dropout", "learning_rate", "decay", "batch", "epochs", "min_updates")
        return {name: getattr(self, name) for name in names}

    def tensors(self) -> dict[str, NDArray[Any]]:
        """Standardisation and the three dense layers."""
        layers = {
            f"network.{place}.{name}": value
            for place, layer in zip(_PLACES, self._layers, strict=False)
            for name, value in zip(("weight", "bias"), layer, strict=True)
        }
        return {"mean": self._mean, "std": self._std, **layers}

    def shapes(self, inputs: int) -> dict[str, tuple[int, ...]]:
        """Standardisation and the three dense layers."""
        (n1, n2), n3 = self.hidden, len(self.experts)
        layers = dict(zip([f"network.{p}" for p in _PLACES], ((n1, inputs), (n2, n1), (n3, n2)), strict=True))
        weights = {f"{name}.weight": shape for name, shape in layers.items()}
        biases = {f"{name}.bias": shape[:1] for name, shape in layers.items()}
        return {"mean": (inputs,), "std": (inputs,), **weights, **biases}

    def restore(self, tensors: Mapping[str, NDArray[Any]]) -> None:
        """Take back standardisation and layers."""
        values = {name: finite(name, value).astype(np.float32) for name, value in tensors.items()}
        self._mean, self._std = values["mean"], positive("std", values["std"])
        there = [f"network.{place}" for place in _PLACES if f"network.{place}.weight" in values]
        self._layers = [(values[f"{name}.weight"], values[f"{name}.bias"]) for name in there]

    def _build(self, inputs: int, outputs: int) -> nn.Sequential:
        """Dense, dropout, dense, dropout, dense; logits come out."""
        from torch import nn

        (n1, n2), (d1, d2) = self.hidden, self.dropout
        layers = [nn.Linear(inputs, n1), nn.ReLU(), nn.Dropout(d1), nn.Linear(n1, n2), nn.ReLU(), nn.Dropout(d2)]
        network = nn.Sequential(*layers, nn.Linear(n2, outputs))
        for layer in network:
            if isinstance(layer, nn.Linear):
                nn.init.xavier_uniform_(layer.weight)
                nn.init.zeros_(layer.bias)
        return network

    def _train(self, network: nn.Sequential, x: Any, rates: Any, truth: Any) -> None:
        """Minimise eq. 5 over ``x`` (M, inputs), expert ``rates`` (M, experts) and ``truth`` (M,), both in deg/s."""
        import torch

        batches = -(-len(x) // self.batch)
        epochs = max(self.epochs, -(-self.min_updates // batches))
        t0 = epochs * batches
        optimiser = torch.optim.Adam(network.parameters(), lr=self.learning_rate)
        schedule = torch.optim.lr_scheduler.LambdaLR(optimiser, lambda t: self.decay ** (t / t0))
        for _ in range(epochs):
            for rows in torch.randperm(len(x)).split(self.batch):
                fused = (torch.softmax(network(x[rows]), dim=-1) * rates[rows]).sum(dim=-1)
                loss = torch.square(fused - truth[rows]).mean()
                optimiser.zero_grad()
                loss.backward()
                optimiser.step()
                schedule.step()


def gate_input(observation: Observation) -> NDArray[np.float32]:
    """x_k of eq. 3, ``(batch, 2 + cameras)``: previous yaw rate, previous speed, matches."""
    return np.concatenate([observation[name] for name in ("previous_yaw_rate", "speed", "matches")], axis=1)
