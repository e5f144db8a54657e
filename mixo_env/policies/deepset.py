"""A deep set over experts: two dense layers for each, their mean over the voters, two more, one number an expert.

Permutation-equivariant by construction (Zaheer et al. 2017, "Deep Sets"). Trained with torch, used without it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mixo_env.policies.lessons import Lessons

if TYPE_CHECKING:
    import torch
    from torch import nn

Layers = tuple[tuple[NDArray[np.float32], NDArray[np.float32]], ...]
"""Weight ``(outputs, inputs)`` and bias of the four dense layers."""

LEAST_WEIGHT = 1e-9
"""Of the consensus, whose logarithm is taken."""

GRADIENT_NORM = 1.0
"""Gradients are cut to it: scenes in which an expert breaks have large ones."""


def corrections(layers: Layers, inputs: NDArray[np.float32], voting: NDArray[np.bool_]) -> NDArray[np.float32]:
    """What is added to the logarithms of the experts' weights, ``(batch, experts)``.

    Args:
        layers: trained.
        inputs: ``(batch, experts, width)``, standardised.
        voting: ``(batch, experts)``.
    """
    batch, experts, width = inputs.shape
    x = inputs.reshape(-1, width)
    for weight, bias in layers[:2]:
        x = np.maximum(x @ weight.T + bias, 0.0)
    hidden = x.reshape(batch, experts, -1)
    share = (voting / voting.sum(axis=1, keepdims=True)).astype(np.float32)
    pooled = (share[:, None] @ hidden)[:, 0]
    (weight, bias), (last, offset) = layers[2:]
    own, common = np.split(weight, 2, axis=1)
    x = np.maximum((x @ own.T).reshape(batch, experts, -1) + (pooled @ common.T + bias)[:, None], 0.0)
    return x @ last[0] + offset


def weigh(correction: NDArray[np.floating], consensus: NDArray[np.floating], voting: NDArray[np.bool_]) -> NDArray:
    """Softmax over the voters of log consensus + correction, ``(batch, experts)`` float64."""
    logits = np.where(voting, np.log(np.maximum(consensus, LEAST_WEIGHT)) + correction, -np.inf)
    weights = np.exp(logits - logits.max(axis=1, keepdims=True))
    return weights / weights.sum(axis=1, keepdims=True)


def train(
    given: Lessons, inputs: NDArray[np.float32], hidden: int, learning_rate: float, updates: int, batch: int
) -> Layers:
    """Adam on the errors of the integrated heading; torch's generator decides the order and the first weights.

    The learning rate falls to zero in a straight line.

    Args:
        given: scenes.
        inputs: ``(scenes, steps, experts, width)``, standardised.
        hidden: width of all layers but the last.
        learning_rate: at the beginning.
        updates: how many; scenes come round in random order.
        batch: scenes in an update, at most.
    """
    import torch
    from torch import nn

    network = _network(inputs.shape[-1], hidden)
    parameters = [value for layer in network for value in layer.parameters()]
    optimiser = torch.optim.Adam(parameters, lr=learning_rate)
    x, voting = torch.from_numpy(inputs), torch.from_numpy(given.voting)
    consensus = torch.from_numpy(np.log(np.maximum(given.consensus, LEAST_WEIGHT)))
    increment, truth = torch.from_numpy(given.increment), torch.from_numpy(given.truth)
    active = torch.from_numpy(given.active)
    pieces = [tuple(torch.from_numpy(part) for part in piece) for piece in given.pieces]

    def errors(rows: torch.Tensor, correct: bool = True) -> tuple[torch.Tensor, torch.Tensor]:
        logits = consensus[rows] + (_forward(network, x[rows], voting[rows]) if correct else 0.0)
        weights = torch.softmax(torch.where(voting[rows], logits, -torch.inf), dim=-1)
        error = ((weights * increment[rows]).sum(dim=-1) - truth[rows]) * active[rows]
        return heading_errors(error, active[rows], [pieces[row] for row in rows.tolist()])

    scenes = torch.arange(len(inputs))
    with torch.no_grad():
        relative, absolute = errors(scenes, correct=False)
    schedule = torch.optim.lr_scheduler.LambdaLR(optimiser, lambda t: 1.0 - t / max(updates, 1))
    rounds = -(-updates // -(-len(inputs) // batch))
    order = [rows for _ in range(rounds) for rows in torch.randperm(len(inputs)).split(batch)]
    for rows in order[:updates]:
        of_pieces, of_scenes = errors(rows)
        loss = of_pieces / relative + of_scenes / absolute
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(parameters, GRADIENT_NORM)
        optimiser.step()
        schedule.step()
    return tuple((layer.weight.detach().numpy().copy(), layer.bias.detach().numpy().copy()) for layer in network)


def heading_errors(
    error: torch.Tensor, active: torch.Tensor, pieces: Sequence[tuple[torch.Tensor, ...]]
) -> tuple[torch.Tensor, torch.Tensor]:
    """What the table counts, of increments that are off by ``error`` ``(scenes, steps)``.

    Returns:
        Mean over all pieces of the heading's change of error per metre, and mean over the scenes of the RMSE of the
        heading about its mean; in units of ``error``.
    """
    import torch

    heading = torch.cat([torch.zeros(len(error), 1), torch.cumsum(error, dim=1)], dim=1)
    off = [(heading[k, end] - heading[k, start]).abs() / length for k, (start, end, length) in enumerate(pieces)]
    driven, count = active.to(error.dtype), active.sum(dim=1)
    mean = (heading[:, 1:] * driven).sum(dim=1) / count
    square = ((heading[:, 1:] - mean[:, None]).square() * driven).sum(dim=1) / count
    return torch.cat(off).mean(), (square + 1e-6).sqrt().mean()


def _network(inputs: int, hidden: int) -> list[nn.Linear]:
    """Four dense layers, the last one zero: an untrained gate corrects nothing."""
    from torch import nn

    layers = [nn.Linear(inputs, hidden), nn.Linear(hidden, hidden), nn.Linear(2 * hidden, hidden), nn.Linear(hidden, 1)]
    nn.init.zeros_(layers[3].weight)
    nn.init.zeros_(layers[3].bias)
    return layers


def _forward(network: list[nn.Linear], x: torch.Tensor, voting: torch.Tensor) -> torch.Tensor:
    """As :func:`corrections`, with gradients."""
    import torch

    hidden = torch.relu(network[1](torch.relu(network[0](x))))
    votes = voting[..., None].to(x.dtype)
    pooled = (hidden * votes).sum(dim=-2, keepdim=True) / votes.sum(dim=-2, keepdim=True)
    joined = torch.cat([hidden, pooled.expand_as(hidden)], dim=-1)
    return network[3](torch.relu(network[2](joined)))[..., 0]
