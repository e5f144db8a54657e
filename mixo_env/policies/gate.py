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
            self._network = self._build(x.shape[1], len(self.experts))
            self._train(
                torch.from_numpy((x - self._mean) / self._std),
                torch.from_numpy(np.degrees(samples["yaw_rates"])),
                torch.from_numpy(np.degrees(samples["truth_yaw_rate"][:, 0])),
            )

    def act(self, observation: Observation) -> Weights:
        """Softmax rows ``(batch, experts)``."""
        import torch

        with torch.inference_mode():
            seen = check_inputs(self.name, gate_input(observation), self._mean)
            x = torch.from_numpy((seen - self._mean) / self._std)
            return softmax(self._network(x).numpy())

    def settings(self) -> dict[str, Any]:
        """Architecture and training."""
        names = ("hidden", "dropout", "learning_rate", "decay", "batch", "epochs", "min_updates")
        return {name: getattr(self, name) for name in names}

    def tensors(self) -> dict[str, NDArray[Any]]:
        """Standardisation and network."""
        network = {f"network.{name}": value.numpy() for name, value in self._network.state_dict().items()}
        return {"mean": self._mean, "std": self._std, **network}

    def shapes(self, inputs: int) -> dict[str, tuple[int, ...]]:
        """Standardisation and the three dense layers."""
        (n1, n2), n3 = self.hidden, len(self.experts)
        layers = {"network.0": (n1, inputs), "network.3": (n2, n1), "network.6": (n3, n2)}
        weights = {f"{name}.weight": shape for name, shape in layers.items()}
        biases = {f"{name}.bias": shape[:1] for name, shape in layers.items()}
        return {"mean": (inputs,), "std": (inputs,), **weights, **biases}

    def restore(self, tensors: Mapping[str, NDArray[Any]]) -> None:
        """Take back standardisation and network."""
        import torch

        tensors = {name: finite(name, value).astype(np.float32) for name, value in tensors.items()}
        self._mean, self._std = tensors["mean"], positive("std", tensors["std"])
        self._network = self._build(len(self._mean), len(self.experts))
        state = {name.removeprefix("network."): torch.from_numpy(tensors[name]) for name in tensors if "." in name}
        self._network.load_state_dict(state)
        self._network.eval()

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

    def _train(self, x: Any, rates: Any, truth: Any) -> None:
        """Minimise eq. 5 over ``x`` (M, inputs), expert ``rates`` (M, experts) and ``truth`` (M,), both in deg/s."""
        import torch

        batches = -(-len(x) // self.batch)
        epochs = max(self.epochs, -(-self.min_updates // batches))
        t0 = epochs * batches
        optimiser = torch.optim.Adam(self._network.parameters(), lr=self.learning_rate)
        schedule = torch.optim.lr_scheduler.LambdaLR(optimiser, lambda t: self.decay ** (t / t0))
        self._network.train()
        for _ in range(epochs):
            for rows in torch.randperm(len(x)).split(self.batch):
                fused = (torch.softmax(self._network(x[rows]), dim=-1) * rates[rows]).sum(dim=-1)
                loss = torch.square(fused - truth[rows]).mean()
                optimiser.zero_grad()
                loss.backward()
                optimiser.step()
                schedule.step()
        self._network.eval()


def gate_input(observation: Observation) -> NDArray[np.float32]:
    """x_k of eq. 3, ``(batch, 2 + cameras)``: previous yaw rate, previous speed, matches."""
    return np.concatenate([observation[name] for name in ("previous_yaw_rate", "speed", "matches")], axis=1)
