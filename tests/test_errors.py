from __future__ import annotations

import pytest

from mixo_env import errors


def test_unknown_names_the_nearest_valid_one() -> None:
    assert errors.unknown("policy", "linaer", ["LINEAR", "MEDIAN"]) == (
        "unknown policy 'linaer': did you mean 'LINEAR'? Valid: LINEAR, MEDIAN"
    )


def test_unknown_without_a_near_name_lists_all() -> None:
    assert errors.unknown("split", "zzz", ["train", "test"]) == "unknown split 'zzz': Valid: test, train"


@pytest.mark.parametrize("name", ["Configuration", "Dataset", "Recording", "Trajectory", "Policy"])
def test_one_base_class(name: str) -> None:
    assert issubclass(getattr(errors, f"{name}Error"), errors.MixoError)
