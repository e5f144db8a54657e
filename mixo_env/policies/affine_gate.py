"""LINEAR GATE: softmax of an affine map of the paper's gate input, which its authors tried in vain."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mixo_env.policies.gate import Mixo

if TYPE_CHECKING:
    from torch import nn


class LinearGate(Mixo):
    """h(A x_k + c) in the place of MIXO's network (PAPER.md: "a linear gating function was tried").

    Input, loss and training are MIXO's, eqs. 3 and 5; without hidden layers there is no dropout.
    """

    name = "LINEAR GATE"

    def __init__(
        self,
        *,
        learning_rate: float = 0.02,
        decay: float = 0.05,
        batch: int = 1024,
        epochs: int = 10,
        min_updates: int = 400,
    ) -> None:
        """Set what is MIXO's too."""
        super().__init__(learning_rate=learning_rate, decay=decay, batch=batch, epochs=epochs, min_updates=min_updates)

    def settings(self) -> dict[str, Any]:
        """Training."""
        return {name: value for name, value in super().settings().items() if name not in ("hidden", "dropout")}

    def shapes(self, inputs: int) -> dict[str, tuple[int, ...]]:
        """Standardisation and the map."""
        experts = len(self.experts)
        network = {"network.0.weight": (experts, inputs), "network.0.bias": (experts,)}
        return {"mean": (inputs,), "std": (inputs,), **network}

    def _build(self, inputs: int, outputs: int) -> nn.Sequential:
        """One dense layer; logits come out."""
        from torch import nn

        layer = nn.Linear(inputs, outputs)
        nn.init.xavier_uniform_(layer.weight)
        nn.init.zeros_(layer.bias)
        return nn.Sequential(layer)
