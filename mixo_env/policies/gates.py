"""Many gates of equal layer sizes trained side by side: what a grid search spends its hours on.

One gate of 16 x 16 is so small that calling a library costs more than its arithmetic. Gates of equal sizes are stacked
and go through every product together; they share the order of the samples, the first weights and the random numbers
of dropout, so a gate does not depend on which others are trained beside it (but for rounding).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import ConfigurationError

FloatArray = NDArray[np.float64]
Single = NDArray[np.float32]

STACK_BYTES = 2**20
"""Hidden values of one stack of gates: more do not stay in a core's cache."""

FEWEST = 4
"""Gates of one stack, however large: below that a product is not worth its call."""

ADAM = (0.9, 0.999, 1e-8)
"""Decay of both moments and the smallest divisor: Adam's own defaults."""


class Setting(NamedTuple):
    """One point of the paper's grid (section IV-B): N1, N2, d1, d2, eta0, alpha."""

    n1: int
    n2: int
    d1: float
    d2: float
    eta0: float
    alpha: float

    @property
    def sizes(self) -> tuple[int, int]:
        """Of both hidden layers."""
        return self.n1, self.n2


class Lesson(NamedTuple):
    """What gates learn from, or are judged by.

    Attributes:
        x: ``(inputs, steps)`` standardised inputs.
        rates: ``(experts, steps)`` yaw rates of the experts [deg/s].
        truth: ``(steps,)`` true yaw rate [deg/s].
    """

    x: Single
    rates: Single
    truth: Single


class Schedule(NamedTuple):
    """How long a training is: equal for all gates of a search.

    Attributes:
        batch: samples of an update.
        updates: of the whole schedule, over which the learning rate falls.
        seed: of everything random.
    """

    batch: int
    updates: int
    seed: int


def errors_after(
    settings: Sequence[Setting], training: Lesson, held_out: Sequence[Lesson], schedule: Schedule, updates: int
) -> FloatArray:
    """Train gates for the first ``updates`` of the schedule.

    Args:
        settings: of equal layer sizes.
        training: what they learn from.
        held_out: what they are judged by, one after the other.
        schedule: the whole schedule.
        updates: how much of it is gone through.

    Returns:
        ``(held_out, settings)`` root mean squared error of the yaw rate [deg/s]; infinite for a gate that diverged.

    Raises:
        ConfigurationError: for layers of different sizes.
    """
    import torch

    if len({setting.sizes for setting in settings}) != 1:
        raise ConfigurationError("gates that are trained together have equal layers: group them by their sizes")
    torch.set_num_threads(1)
    width = max(FEWEST, STACK_BYTES // (4 * schedule.batch * sum(settings[0].sizes)))
    stacks = [settings[i : i + width] for i in range(0, len(settings), width)]
    return np.concatenate([_errors(stack, training, held_out, schedule, updates) for stack in stacks], axis=1)


def _errors(
    settings: Sequence[Setting], training: Lesson, held_out: Sequence[Lesson], schedule: Schedule, updates: int
) -> FloatArray:
    import torch

    stack = _Stack(settings, training, schedule)
    with torch.inference_mode():
        for number, rows in enumerate(_batches(len(training.truth), schedule, updates)):
            stack.update(number, rows)
        return np.stack([stack.errors(lesson) for lesson in held_out])


def _batches(steps: int, schedule: Schedule, updates: int) -> Iterator[NDArray[np.int64]]:
    """Rows of each update: the samples in a new order every time they are through."""
    rng = np.random.default_rng([schedule.seed, 1])
    while True:
        order = rng.permutation(steps)
        for first in range(0, steps, schedule.batch):
            if updates == 0:
                return
            updates -= 1
            yield order[first : first + schedule.batch]


class _Stack:
    """Parameters ``(gates, outputs, inputs)`` of gates of equal sizes, and one update of all of them."""

    def __init__(self, settings: Sequence[Setting], training: Lesson, schedule: Schedule) -> None:
        import torch

        self._x, self._rates, self._truth = (torch.tensor(values) for values in training)
        self._schedule, (n1, n2) = schedule, settings[0].sizes
        sizes = ((n1, len(training.x)), (n2, n1), (len(training.rates), n2))
        rng = np.random.default_rng([schedule.seed, 0])
        gates = len(settings)
        self._weights, self._biases = [], []
        for outputs, inputs in sizes:  # Xavier's uniform initialisation, as the gate's own
            bound = np.sqrt(6.0 / (outputs + inputs))
            first = rng.uniform(-bound, bound, (1, outputs, inputs)).astype(np.float32)
            self._weights.append(torch.from_numpy(np.repeat(first, gates, axis=0)))
            self._biases.append(torch.zeros(gates, outputs, 1))
        self._parameters = [*self._weights, *self._biases]
        self._moments = [(torch.zeros_like(p), torch.zeros_like(p)) for p in self._parameters]
        table = np.array(settings, dtype=np.float64)
        self._dropped = [torch.from_numpy(table[:, k].astype(np.float32)).reshape(-1, 1, 1) for k in (2, 3)]
        self._eta0, self._alpha = table[:, 4].reshape(-1, 1, 1), table[:, 5].reshape(-1, 1, 1)
        self._dice = torch.Generator().manual_seed(schedule.seed)

    def update(self, number: int, rows: NDArray[np.int64]) -> None:
        """Adam on the squared error of eq. 5 over one batch; ``number`` counts updates from 0."""
        import torch

        chosen = torch.from_numpy(rows)
        x, rates, truth = self._x[:, chosen], self._rates[:, chosen], self._truth[chosen]
        w1, w2, w3 = self._weights
        h1, keep1 = self._hidden(torch.matmul(w1.reshape(-1, len(x)), x).reshape(*w1.shape[:2], -1), 0)
        h2, keep2 = self._hidden(torch.bmm(w2, h1), 1)
        share = torch.softmax(torch.bmm(w3, h2).add_(self._biases[2]), dim=1)
        fused = (share * rates).sum(dim=1, keepdim=True)
        slope = (fused - truth).mul_(2.0 / len(rows))
        d3 = share.mul_(rates - fused).mul_(slope)  # d loss / d logits
        d2 = torch.bmm(w3.mT, d3).mul_(keep2)
        d1 = torch.bmm(w2.mT, d2).mul_(keep1)
        by_x = torch.matmul(d1.reshape(-1, d1.shape[2]), x.T).reshape(w1.shape)
        weights = [by_x, torch.bmm(d2, h1.mT), torch.bmm(d3, h2.mT)]
        self._step(number, [*weights, *(d.sum(dim=2, keepdim=True) for d in (d1, d2, d3))])

    def _hidden(self, sums: Any, layer: int) -> tuple[Any, Any]:
        """Rectified sums after dropout, and what the gradient is multiplied by on its way back."""
        import torch

        keep = (sums.add_(self._biases[layer]) > 0.0).to(torch.float32)
        rate = self._dropped[layer]
        if rate.any():
            dice = torch.rand(sums.shape[1:], generator=self._dice)
            keep.mul_(dice >= rate).div_(1.0 - rate)
        else:
            torch.rand(sums.shape[1:], generator=self._dice)
        return sums.mul_(keep), keep

    def _step(self, number: int, gradients: Sequence[Any]) -> None:
        import torch

        beta1, beta2, smallest = ADAM
        t = number + 1
        eta = self._eta0 * self._alpha ** (number / self._schedule.updates) / (1.0 - beta1**t)
        rate = torch.from_numpy(eta.astype(np.float32))
        for parameter, gradient, (first, second) in zip(self._parameters, gradients, self._moments, strict=True):
            first.lerp_(gradient, 1.0 - beta1)
            second.mul_(beta2).addcmul_(gradient, gradient, value=1.0 - beta2)
            scale = (second / (1.0 - beta2**t)).sqrt_().add_(smallest)
            parameter.sub_(rate * first / scale)

    def errors(self, lesson: Lesson) -> FloatArray:
        """Root mean squared error ``(gates,)`` without dropout."""
        import torch

        total = torch.zeros(len(self._eta0), dtype=torch.float64)
        (w1, w2, w3), (b1, b2, b3) = self._weights, self._biases
        for first in range(0, len(lesson.truth), self._schedule.batch):
            x, rates, truth = (torch.from_numpy(v[..., first : first + self._schedule.batch]) for v in lesson)
            h = torch.relu_(torch.matmul(w1, x).add_(b1))
            h = torch.relu_(torch.bmm(w2, h).add_(b2))
            share = torch.softmax(torch.bmm(w3, h).add_(b3), dim=1)
            total += torch.square((share * rates).sum(dim=1) - truth).sum(dim=1, dtype=torch.float64)
        errors = torch.sqrt(total / len(lesson.truth)).numpy()
        return np.where(np.isfinite(errors), errors, np.inf)
