"""Short runs of the scripts that damage folders, saved policies and networks at random."""

from __future__ import annotations

import pytest

from experiments.fuzz import folders, networks, policies
from tests.synthetic import synthetic_recordings

pytestmark = pytest.mark.faults


def test_damaged_tables_and_messages_are_judged_or_refused_in_one_line(tmp_path):
    outcome = folders.fuzz(folders.small_folder(tmp_path / "data"), inputs=200, seed=0)
    assert outcome.faults == []
    for kind in ("table", "message"):
        assert outcome.counts[f"{kind}: sound"] > 0
        assert outcome.counts[f"{kind}: problems"] > 0
    assert outcome.counts["table: refused"] > 10


def test_damaged_policies_give_weights_or_one_line(tmp_path):
    recordings = synthetic_recordings(0, scenes=3)
    files = policies.saved(recordings, tmp_path)
    outcome = policies.fuzz(recordings, files, inputs=500, seed=0, folder=tmp_path)
    assert outcome.faults == []
    assert outcome.counts["refused"] > 100
    assert outcome.counts["played"] > 10


def test_damaged_networks_give_actions_or_one_line(tmp_path):
    outcome = networks.fuzz(synthetic_recordings(0, scenes=3), inputs=1000, seed=0, folder=tmp_path)
    assert outcome.faults == []
    assert outcome.counts["refused"] > 100
    assert outcome.counts["played"] > 10
