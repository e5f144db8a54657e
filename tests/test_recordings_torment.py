"""Recordings under random damage and random kills: short runs of the scripts that do so at length."""

from __future__ import annotations

import pytest

from experiments.fuzz.stores import fuzz
from experiments.kill_record import torment
from mixo_env.recordings.record import RecordConfig, record
from tests.recording_fakes import FAKES, FakeDataset, make_scene
from tests.synthetic import synthetic_recordings

pytestmark = pytest.mark.faults


def test_damaged_recordings_are_refused_in_one_line_or_whole(tmp_path):
    outcome = fuzz(synthetic_recordings(scenes=2, steps=15), inputs=150, seed=0, folder=tmp_path)
    assert outcome.faults == []
    assert outcome.counts["rows: salvaged"] > 0
    assert outcome.counts["values: refused"] + outcome.counts["values: salvaged"] > 20


def test_forty_kills_lose_nothing(tmp_path):
    names = [f"scene-{2001 + i}" for i in range(6)]
    dataset = FakeDataset({name: make_scene(tmp_path / "images", name, name[-1]) for name in names})

    def run(out, scenes):
        record(dataset, RecordConfig(scenes=scenes), out, experts=FAKES)

    outcome = torment(run, names[0], kills=40, seed=0, folder=tmp_path)
    assert outcome.faults == []
    assert outcome.kills == 40
    assert outcome.commits > 0
