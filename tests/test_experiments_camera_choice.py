"""Choosing cameras from tiny pictures: what a choice costs, and that a network finds what pictures foretell."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from experiments.camera_choice import SIZE, City, Foresight, images_ms, main


def made(rng: np.random.Generator, steps: int = 400, *, told: bool = True) -> City:
    """One camera: in the dark it errs by 3, else by 1; without it, 2. Untold, pictures say nothing of it."""
    dark = rng.random(steps) < 0.5
    shown = dark if told else rng.random(steps) < 0.5
    pictures = np.where(shown[:, None, None, None], 20, 200).astype(np.uint8) * np.ones((1, 1, *SIZE), np.uint8)
    losses = np.stack([np.full(steps, 2.0), np.where(dark, 3.0, 1.0)], axis=1)
    return City(losses, pictures, np.ones((steps, 1)), np.arange(steps) == 0, 0.0)


def test_every_image_is_paid_for_once_and_a_pause_costs_the_image_before() -> None:
    on = np.array([[True, True], [True, False], [False, True], [True, True]])
    first = np.array([True, False, False, True])
    # Images: 2 + 2 of the first step, 1 of the second, 2 of the woken camera, 2 + 2 where the next scene begins.
    assert images_ms(on, first, np.array([1.0, 1.0])) == pytest.approx(11 / 4)
    assert images_ms(on, first, np.array([1.0, 10.0])) == pytest.approx((2 + 20 + 1 + 20 + 2 + 20) / 4)


def test_the_network_finds_what_pictures_foretell() -> None:
    rng = np.random.default_rng(0)
    foresight, unseen = Foresight(made(rng), epochs=6, seed=0), made(rng, 100)
    chosen = np.argmin(foresight(unseen.pictures), axis=1)
    assert foresight.epoch > 0
    np.testing.assert_array_equal(chosen, np.argmin(unseen.losses, axis=1))


def test_where_pictures_say_nothing_the_training_mean_stays() -> None:
    training = made(np.random.default_rng(1), 3000, told=False)
    foresight = Foresight(training, epochs=2, seed=0)
    mean = training.losses[: int(0.8 * len(training.losses))].mean(axis=0)
    np.testing.assert_allclose(foresight(training.pictures), np.tile(mean, (3000, 1)), atol=0.2)


def test_a_folder_that_is_none_is_one_line(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    places = [str(tmp_path), str(tmp_path)]
    assert main(["--cities", *places, "--recordings", *places]) == 1
    assert len(caplog.records) == 1
