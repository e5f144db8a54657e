"""Gates trained side by side are the gates that would have been trained alone, and those of plain torch."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import nn

from mixo_env.errors import ConfigurationError
from mixo_env.policies import gates
from mixo_env.policies.gates import Lesson, Schedule, Setting, errors_after

STEPS, INPUTS, EXPERTS = 300, 6, 4
SCHEDULE = Schedule(batch=64, updates=40, seed=3)


def lesson(seed: int, steps: int = STEPS) -> Lesson:
    rng = np.random.default_rng(seed)
    x, rates = (rng.normal(size=(n, steps)).astype(np.float32) for n in (INPUTS, EXPERTS))
    better = (x[0] > 0).astype(np.float32)  # the first expert is right where the first input is positive
    return Lesson(x, rates, better * rates[0] + (1.0 - better) * rates[1])


def plain(setting: Setting, training: Lesson, held_out: Lesson, updates: int) -> float:
    """The same training by torch's own layers and optimiser, without dropout, from the same first weights."""
    rng = np.random.default_rng([SCHEDULE.seed, 0])
    sizes = ((setting.n1, INPUTS), (setting.n2, setting.n1), (EXPERTS, setting.n2))
    network = nn.Sequential(nn.Linear(INPUTS, setting.n1), nn.ReLU(), nn.Linear(setting.n1, setting.n2), nn.ReLU())
    network.append(nn.Linear(setting.n2, EXPERTS))
    for layer, (outputs, inputs) in zip([one for one in network if isinstance(one, nn.Linear)], sizes, strict=True):
        bound = np.sqrt(6.0 / (outputs + inputs))
        first = rng.uniform(-bound, bound, (outputs, inputs)).astype(np.float32)
        layer.weight.data = torch.from_numpy(first)
        nn.init.zeros_(layer.bias)
    optimiser = torch.optim.Adam(network.parameters(), lr=setting.eta0)
    fall = torch.optim.lr_scheduler.LambdaLR(optimiser, lambda t: setting.alpha ** (t / SCHEDULE.updates))
    x, rates, truth = (torch.from_numpy(values.T.copy()) for values in training)
    for rows in gates._batches(STEPS, SCHEDULE, updates):
        fused = (torch.softmax(network(x[rows]), dim=1) * rates[rows]).sum(dim=1)
        loss = torch.square(fused - truth[rows]).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        fall.step()
    with torch.no_grad():
        x, rates, truth = (torch.from_numpy(values.T.copy()) for values in held_out)
        fused = (torch.softmax(network(x), dim=1) * rates).sum(dim=1)
        return float(torch.sqrt(torch.square(fused - truth).mean()))


@pytest.mark.parametrize("sizes", [(8, 8), (16, 5), (3, 32)])
def test_without_dropout_a_gate_is_that_of_torch(sizes: tuple[int, int]) -> None:
    settings = [Setting(*sizes, 0.0, 0.0, 0.02, 0.05), Setting(*sizes, 0.0, 0.0, 0.005, 0.5)]
    errors = errors_after(settings, lesson(0), [lesson(1), lesson(2)], SCHEDULE, 30)
    expected = [[plain(setting, lesson(0), lesson(seed), 30) for setting in settings] for seed in (1, 2)]
    np.testing.assert_allclose(errors, expected, rtol=2e-4)


def test_a_gate_does_not_depend_on_those_beside_it() -> None:
    settings = [Setting(8, 16, d1, d2, eta0, 0.1) for d1 in (0.0, 0.4) for d2 in (0.0, 0.2) for eta0 in (0.01, 0.05)]
    together = errors_after(settings, lesson(0), [lesson(1)], SCHEDULE, 40)[0]
    alone = [errors_after([setting], lesson(0), [lesson(1)], SCHEDULE, 40)[0, 0] for setting in settings]
    np.testing.assert_allclose(together, alone, rtol=1e-4)
    assert len(np.unique(np.round(together, 6))) == len(settings)


def test_stacks_are_cut_without_a_trace(monkeypatch: pytest.MonkeyPatch) -> None:
    settings = [Setting(8, 8, 0.1, 0.1, eta0, 0.1) for eta0 in np.linspace(0.001, 0.05, 11)]
    whole = errors_after(settings, lesson(0), [lesson(1)], SCHEDULE, 10)
    monkeypatch.setattr(gates, "STACK_BYTES", 1)
    np.testing.assert_allclose(errors_after(settings, lesson(0), [lesson(1)], SCHEDULE, 10), whole, rtol=1e-5)


def test_dropout_keeps_the_mean_and_its_share() -> None:
    stack = gates._Stack([Setting(400, 4, 0.4, 0.0, 0.01, 0.1)], lesson(0), SCHEDULE)
    with torch.inference_mode():
        hidden, _ = stack._hidden(torch.ones(1, 400, 64), 0)
    assert float((hidden == 0.0).float().mean()) == pytest.approx(0.4, abs=0.01)
    assert float(hidden.mean()) == pytest.approx(1.0, abs=0.02)


def test_the_first_input_is_found_out() -> None:
    error = errors_after([Setting(16, 16, 0.0, 0.0, 0.02, 0.1)], lesson(0, 3000), [lesson(1)], SCHEDULE, 400)
    assert error[0, 0] < 0.35  # either expert alone: 1


def test_a_gate_that_diverges_loses_and_does_not_break_the_others() -> None:
    huge = lesson(0)._replace(rates=np.full((EXPERTS, STEPS), 3e38, np.float32))
    assert np.isinf(errors_after([Setting(8, 8, 0.0, 0.0, 0.01, 0.1)], huge, [huge], SCHEDULE, 2)).all()


def test_every_sample_is_seen_before_one_is_seen_again() -> None:
    batches = list(gates._batches(100, Schedule(30, 8, 0), 8))
    assert [len(rows) for rows in batches] == [30, 30, 30, 10] * 2
    for half in (batches[:4], batches[4:]):
        assert sorted(np.concatenate(half).tolist()) == list(range(100))


def test_gates_of_different_sizes_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="equal layers"):
        errors_after(
            [Setting(8, 8, 0, 0, 0.1, 0.1), Setting(8, 9, 0, 0, 0.1, 0.1)], lesson(0), [lesson(1)], SCHEDULE, 1
        )
