"""A deep set over experts: two dense layers for each, their mean over the voters, two more, one number an expert.

Permutation-equivariant by construction (Zaheer et al. 2017, "Deep Sets"). Trained with torch, used without it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mixo_env.compiled import compiled_unchecked, inlined
from mixo_env.policies.lessons import Lessons

if TYPE_CHECKING:
    import torch
    from torch import nn

FloatArray = NDArray[np.float64]
Single = NDArray[np.float32]
Layers = tuple[tuple[Single, Single], ...]
"""Weight ``(inputs, outputs)`` and bias of the four dense layers."""

AT_ONCE = 32
"""Scenes whose tokens pass the network side by side: vector units are full, and all fits into the first cache."""

MOST = 3.0
"""Of what the network can add to a logarithm: a factor of twenty. An expert further off than any in training keeps the
consensus' small weight, whatever the network makes of it."""

LEAST_WEIGHT = 1e-9
"""Of the consensus, whose logarithm is taken."""

AVERAGED = 50
"""Updates that the running mean of the network remembers, which is what is kept; a tenth of them at the beginning."""

GRADIENT_NORM = 1.0
"""Gradients are cut to it: scenes in which an expert breaks have large ones."""


def folded(layers: Layers, mean: NDArray[np.float32], std: NDArray[np.float32]) -> Layers:
    """The same network on inputs that are not standardised."""
    (weight, bias), *rest = layers
    scaled = (weight / std[:, None]).astype(np.float32)
    return ((scaled, (bias - mean @ scaled).astype(np.float32)), *rest)


def weigh(layers: Layers, told: tuple[Single, Single, FloatArray], voting: NDArray[np.bool_]) -> FloatArray:
    """Softmax over the voters of log consensus + what the network adds, ``(batch, experts)``.

    Args:
        layers: on inputs as they come.
        told: signals ``(batch, experts, n)``, whole ``(batch, m)`` and consensus ``(batch, experts)``.
        voting: ``(batch, experts)``; one that is false has no weight.
    """
    weights = np.empty(voting.shape)
    _weigh(told, voting, layers, weights)
    return weights


@inlined
def _dense(x: Single, weight: Single, out: Single) -> None:
    """Add ``W' x`` to ``out``, tokens side by side: ``x`` is ``(inputs, tokens)``, ``out`` ``(outputs, tokens)``."""
    whole = len(x) // 4 * 4
    for j in range(len(out)):
        for i in range(0, whole, 4):  # four at once: each number of ``out`` is loaded and stored a quarter as often
            for t in range(out.shape[1]):
                first = x[i, t] * weight[i, j] + x[i + 1, t] * weight[i + 1, j]
                out[j, t] += first + (x[i + 2, t] * weight[i + 2, j] + x[i + 3, t] * weight[i + 3, j])
        for i in range(whole, len(x)):
            for t in range(out.shape[1]):
                out[j, t] += x[i, t] * weight[i, j]


@inlined
def _fill(bias: Single, out: Single) -> None:
    for j in range(len(out)):
        for t in range(out.shape[1]):
            out[j, t] = bias[j]


@inlined
def _share(scene: Single, tokens: Single) -> None:
    """Write what is the same for all experts of a scene, ``(outputs, scenes)``, to ``(outputs, experts, scenes)``."""
    for j in range(len(tokens)):
        for e in range(tokens.shape[1]):
            for s in range(tokens.shape[2]):
                tokens[j, e, s] = scene[j, s]


@inlined
def _rectify(x: Single) -> None:
    for j in range(len(x)):
        for t in range(x.shape[1]):
            x[j, t] = max(x[j, t], np.float32(0.0))


@compiled_unchecked
def _weigh(
    told: tuple[Single, Single, FloatArray], voting: NDArray[np.bool_], layers: Layers, weights: FloatArray
) -> None:
    """:func:`weigh`; arrays of what happens inside have the scenes last."""
    signals, whole, consensus = told
    (first, a), (second, b), (third, c), (last, d) = layers
    batch, experts, length = signals.shape
    width, scenes = len(a), min(batch, AT_ONCE)
    tokens = experts * scenes
    x, step = np.empty((length, experts, scenes), np.float32), np.empty((whole.shape[1], scenes), np.float32)
    one, two = np.empty((width, experts, scenes), np.float32), np.empty((width, experts, scenes), np.float32)
    base, pooled = np.empty((width, scenes), np.float32), np.empty((width, scenes), np.float32)
    votes, count = np.empty((experts, scenes), np.float32), np.empty(scenes, np.float32)
    number = np.empty((1, tokens), np.float32)
    flat_x, flat_one, flat_two = x.reshape(length, tokens), one.reshape(width, tokens), two.reshape(width, tokens)
    for start in range(0, batch, AT_ONCE):
        k = min(start, batch - scenes)  # the last ones overlap those before
        count[:], pooled[:] = 0.0, 0.0
        for s in range(scenes):
            for i in range(len(step)):
                step[i, s] = whole[k + s, i]
            for e in range(experts):
                votes[e, s] = 1.0 if voting[k + s, e] else 0.0
                count[s] += votes[e, s]
                for i in range(length):
                    x[i, e, s] = signals[k + s, e, i]
        _fill(a, base)
        _dense(step, first[length:], base)
        _share(base, one)
        _dense(flat_x, first[:length], flat_one)
        _rectify(flat_one)
        _fill(b, flat_two)
        _dense(flat_one, second, flat_two)
        _rectify(flat_two)
        for j in range(width):
            for e in range(experts):
                for s in range(scenes):
                    pooled[j, s] += votes[e, s] * two[j, e, s]
            for s in range(scenes):
                pooled[j, s] /= count[s]
        _fill(c, base)
        _dense(pooled, third[width:], base)
        _share(base, one)
        _dense(flat_two, third[:width], flat_one)
        _rectify(flat_one)
        _fill(d, number)
        _dense(flat_one, last, number)
        for s in range(scenes):
            largest, total = -np.inf, 0.0
            for e in range(experts):
                told_more = number[0, e * scenes + s]
                number[0, e * scenes + s] = told_more / (np.float32(1.0) + abs(told_more) / np.float32(MOST))
                if voting[k + s, e]:
                    largest = max(largest, number[0, e * scenes + s])
            for e in range(experts):
                grown = math.exp(number[0, e * scenes + s] - largest) if voting[k + s, e] else 0.0
                weights[k + s, e] = max(consensus[k + s, e], LEAST_WEIGHT) * grown
                total += weights[k + s, e]
            for e in range(experts):
                weights[k + s, e] /= total


def train(
    given: Lessons, inputs: NDArray[np.float32], hidden: int, learning_rate: float, epochs: int, batch: int
) -> Layers:
    """Adam on the errors of the integrated heading; torch's generator decides the order and the first weights.

    The result is the running mean of the network over the updates (Polyak and Juditsky 1992): the few scenes of an
    update say little, and so the end of the training needs no falling learning rate.

    Args:
        given: scenes.
        inputs: ``(scenes, steps, experts, width)``, standardised.
        hidden: width of all layers but the last.
        learning_rate: of all updates.
        epochs: how often all scenes come round, each time in another order.
        batch: scenes in an update, at most.
    """
    import torch
    from torch import nn
    from torch.optim.swa_utils import AveragedModel

    network = _network(inputs.shape[-1], hidden)
    averaged = AveragedModel(network, avg_fn=_remember)
    optimiser = torch.optim.Adam(network.parameters(), lr=learning_rate)
    x, voting = torch.from_numpy(inputs), torch.from_numpy(given.voting)
    consensus = torch.from_numpy(np.log(np.maximum(given.consensus, LEAST_WEIGHT)))
    increment, truth = torch.from_numpy(given.increment), torch.from_numpy(given.truth)
    active = torch.from_numpy(given.active)
    pieces = [tuple(torch.from_numpy(part) for part in piece) for piece in given.pieces]
    beside = torch.from_numpy(given.beside)

    def errors(rows: torch.Tensor, correct: bool = True) -> tuple[torch.Tensor, torch.Tensor]:
        logits = consensus[rows] + (_forward(network, x[rows], voting[rows]) if correct else 0.0)
        weights = torch.softmax(torch.where(voting[rows], logits, -torch.inf), dim=-1)
        fused = (weights * increment[rows]).sum(dim=-1)
        fused = torch.where(torch.isnan(beside[rows]), fused, 0.5 * (fused + beside[rows]))
        error = (fused - truth[rows]) * active[rows]
        return heading_errors(error, active[rows], [pieces[row] for row in rows.tolist()])

    scenes = torch.arange(len(inputs))
    with torch.no_grad():
        relative, absolute = errors(scenes, correct=False)
    for rows in (rows for _ in range(epochs) for rows in torch.randperm(len(inputs)).split(batch)):
        of_pieces, of_scenes = errors(rows)
        loss = of_pieces / relative + of_scenes / absolute
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), GRADIENT_NORM)
        optimiser.step()
        averaged.update_parameters(network)
    layers: Sequence[nn.Linear] = list(averaged.module)  # type: ignore[arg-type]
    return tuple((layer.weight.detach().numpy().T.copy(), layer.bias.detach().numpy().copy()) for layer in layers)


def _remember(mean: torch.Tensor, newest: torch.Tensor, before: torch.Tensor | int) -> torch.Tensor:
    return mean + (newest - mean) * max(1.0 / AVERAGED, 10.0 / (10.0 + float(before)))


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


def _network(inputs: int, hidden: int) -> nn.ModuleList:
    """Four dense layers, the last one zero: an untrained gate corrects nothing."""
    from torch import nn

    first, second, third = nn.Linear(inputs, hidden), nn.Linear(hidden, hidden), nn.Linear(2 * hidden, hidden)
    last = nn.Linear(hidden, 1)
    nn.init.zeros_(last.weight)
    nn.init.zeros_(last.bias)
    return nn.ModuleList([first, second, third, last])


def _forward(network: nn.ModuleList, x: torch.Tensor, voting: torch.Tensor) -> torch.Tensor:
    """What is added to the logarithms of the consensus, ``(..., experts)``, with gradients."""
    import torch

    hidden = torch.relu(network[1](torch.relu(network[0](x))))
    votes = voting[..., None].to(x.dtype)
    pooled = (hidden * votes).sum(dim=-2, keepdim=True) / votes.sum(dim=-2, keepdim=True)
    joined = torch.cat([hidden, pooled.expand_as(hidden)], dim=-1)
    added = network[3](torch.relu(network[2](joined)))[..., 0]
    return added / (1.0 + added.abs() / MOST)
