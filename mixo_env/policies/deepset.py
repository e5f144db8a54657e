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
from mixo_env.policies.blocks import AT_ONCE
from mixo_env.policies.lessons import Lessons

if TYPE_CHECKING:
    import torch
    from torch import nn

FloatArray = NDArray[np.float64]
Single = NDArray[np.float32]
Layers = tuple[tuple[Single, Single], ...]
"""Weight ``(inputs, outputs)`` and bias of the four dense layers."""

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


def packed(layers: Layers) -> Single:
    """All numbers of a network for :func:`weigh`, ``(rows, width)``: every bias follows the rows of its weights.

    The last layer has one row of weights, and its only bias fills another.
    """
    first, second, third, (weight, bias) = layers
    parts = [part for layer in (first, second, third) for part in layer]
    return np.vstack([*parts, weight.T, np.full(len(weight), bias[0], np.float32)])


def weigh(network: Single, told: tuple[Single, Single, FloatArray], voting: NDArray[np.bool_]) -> FloatArray:
    """Softmax over the voters of log consensus + what the network adds, ``(batch, experts)``.

    Args:
        network: as :func:`packed` has it, on inputs as they come.
        told: :class:`~mixo_env.policies.tokens.Tokens`, in blocks of scenes: signals ``(blocks, n, experts, scenes)``,
            whole ``(blocks, m, scenes)`` and consensus ``(blocks, experts, scenes)``.
        voting: ``(batch, experts)``; one that is false has no weight.
    """
    signals, whole, consensus = told
    weights = np.empty(voting.shape)
    _weigh((signals, whole), consensus, voting, network, weights)
    return weights


@inlined
def _dense(x: Single, weight: Single, out: Single, row: Single) -> None:
    """Add ``W' x`` to ``out``, tokens side by side: ``x`` is ``(inputs, tokens)``, ``out`` ``(outputs, tokens)``.

    Whichever there are more of, tokens or outputs, is summed side by side, in the same order; ``row`` ``(outputs,)`` is
    written on the way.
    """
    if out.shape[1] < len(out):
        for t in range(out.shape[1]):
            for j in range(len(row)):
                row[j] = out[j, t]
            _add_products(weight, x, t, row)
            for j in range(len(row)):
                out[j, t] = row[j]
    else:
        even = len(out) // 2 * 2
        for j in range(0, even, 2):
            _add_two_products(x, weight, j, out[j], out[j + 1])
        for j in range(even, len(out)):
            _add_products(x, weight, j, out[j])


@inlined
def _add_products(x: Single, weights: Single, j: int, out: Single) -> None:
    """Add ``x' w`` to ``out`` ``(n,)``: ``x`` is ``(inputs, n)``, w column ``j`` of ``weights`` ``(inputs, ..)``."""
    whole = len(x) // 4 * 4
    for i in range(0, whole, 4):  # four at once: each number of ``out`` is loaded and stored a quarter as often
        for t in range(len(out)):
            first = x[i, t] * weights[i, j] + x[i + 1, t] * weights[i + 1, j]
            out[t] += first + (x[i + 2, t] * weights[i + 2, j] + x[i + 3, t] * weights[i + 3, j])
    for i in range(whole, len(x)):
        for t in range(len(out)):
            out[t] += x[i, t] * weights[i, j]


@inlined
def _add_two_products(x: Single, weights: Single, j: int, out: Single, other: Single) -> None:
    """:func:`_add_products` of columns ``j`` and ``j + 1``: each number of ``x`` is loaded half as often."""
    whole = len(x) // 4 * 4
    for i in range(0, whole, 4):
        for t in range(len(out)):
            a, b, c, d = x[i, t], x[i + 1, t], x[i + 2, t], x[i + 3, t]
            first = a * weights[i, j] + b * weights[i + 1, j]
            out[t] += first + (c * weights[i + 2, j] + d * weights[i + 3, j])
            second = a * weights[i, j + 1] + b * weights[i + 1, j + 1]
            other[t] += second + (c * weights[i + 2, j + 1] + d * weights[i + 3, j + 1])
    for i in range(whole, len(x)):
        for t in range(len(out)):
            out[t] += x[i, t] * weights[i, j]
            other[t] += x[i, t] * weights[i, j + 1]


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


@inlined
def _vote(added: Single, consensus: FloatArray, voting: NDArray[np.bool_], first: int, weights: FloatArray) -> None:
    """Write weights of the scenes from ``first`` on: ``added`` and ``consensus`` are ``(experts, scenes)``."""
    experts, scenes = added.shape
    for s in range(scenes):
        b = min(first + s, len(voting) - 1)
        largest, total = -np.inf, 0.0
        for e in range(experts):
            if voting[b, e]:
                largest = max(largest, added[e, s])
        for e in range(experts):
            grown = math.exp(added[e, s] - largest) if voting[b, e] else 0.0
            weights[b, e] = max(consensus[e, s], LEAST_WEIGHT) * grown
            total += weights[b, e]
        for e in range(experts):
            weights[b, e] /= total


@compiled_unchecked
def _weigh(
    told: tuple[Single, Single],
    consensus: FloatArray,
    voting: NDArray[np.bool_],
    network: Single,
    weights: FloatArray,
) -> None:
    """:func:`weigh`; ``told`` without the consensus."""
    signals, whole = told
    blocks, length, experts, scenes = signals.shape
    batch, width, tokens = len(voting), network.shape[1], experts * scenes
    second = length + whole.shape[1] + 1  # rows of the weights
    third = second + width + 1
    last = third + 2 * width + 1
    wide, narrow = np.empty((2, width, experts, scenes), np.float32), np.empty((2, width, scenes), np.float32)
    row = np.empty(width, np.float32)
    votes, number = np.empty((experts + 1, scenes), np.float32), np.empty((1, tokens), np.float32)
    one, two, base, pooled, count = wide[0], wide[1], narrow[0], narrow[1], votes[experts]
    flat_one, flat_two = one.reshape(width, tokens), two.reshape(width, tokens)
    flat_x = signals.reshape(blocks, length, tokens)
    for k in range(blocks):
        first = k * AT_ONCE
        count[:], pooled[:] = 0.0, 0.0
        for s in range(scenes):
            for e in range(experts):
                votes[e, s] = 1.0 if voting[min(first + s, batch - 1), e] else 0.0
                count[s] += votes[e, s]
        _fill(network[second - 1], base)
        _dense(whole[k], network[length : second - 1], base, row)
        _share(base, one)
        _dense(flat_x[k], network[:length], flat_one, row)
        _rectify(flat_one)
        _fill(network[third - 1], flat_two)
        _dense(flat_one, network[second : third - 1], flat_two, row)
        _rectify(flat_two)
        for j in range(width):
            for e in range(experts):
                for s in range(scenes):
                    pooled[j, s] += votes[e, s] * two[j, e, s]
            for s in range(scenes):
                pooled[j, s] /= count[s]
        _fill(network[last - 1], base)
        _dense(pooled, network[third + width : last - 1], base, row)
        _share(base, one)
        _dense(flat_two, network[third : third + width], flat_one, row)
        _rectify(flat_one)
        _fill(network[last + 1], number)
        _dense(flat_one, network[last].reshape(width, 1), number, row)
        for t in range(tokens):
            number[0, t] /= np.float32(1.0) + abs(number[0, t]) / np.float32(MOST)
        _vote(number[0].reshape(experts, scenes), consensus[k], voting, first, weights)


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
