"""What a collection of recordings refuses, in one line that names the nearest valid thing."""

from __future__ import annotations

import numpy as np
import pytest

from mixo_env.errors import ConfigurationError, RecordingError
from mixo_env.recordings.collection import Recordings
from tests.synthetic import synthetic_recordings


@pytest.fixture(scope="module")
def recordings() -> Recordings:
    return synthetic_recordings(scenes=2, logs=2, steps=20)


def test_a_column_of_another_length_is_refused(recordings):
    with pytest.raises(RecordingError, match=r"column 'step' has 3 rows, but the manifest counts \d+: record anew"):
        Recordings(recordings.manifest, {"step": np.arange(3)})


def test_an_unknown_column_is_named_with_the_nearest(recordings):
    with pytest.raises(RecordingError, match=r"truth\.yaw_rad"):
        recordings["truth.yaw"]


def test_an_unknown_scene_is_named_with_the_nearest(recordings):
    known = recordings.scenes[1].name
    assert recordings.index(known) == 1
    with pytest.raises(ConfigurationError, match=known):
        recordings.index(known + "x")


def test_an_unknown_track_is_named_with_the_nearest(recordings):
    with pytest.raises(ConfigurationError, match="VISION"):
        recordings.voters("VISON")


def test_an_unknown_split_is_named_with_the_nearest(recordings):
    with pytest.raises(ConfigurationError, match="train"):
        recordings.select(split="trian")
