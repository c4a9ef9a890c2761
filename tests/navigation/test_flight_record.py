"""A flight that nobody waited for: a record with its results, whole or absent."""

import numpy as np
import pytest

from ursnav_torch.devices import Frame
from ursnav_torch.errors import InputError
from ursnav_torch.navigation.flight_record import RATE_HZ, record_flight
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.session import Replay


def test_a_flight_is_kept_with_what_navigation_said_of_every_picture(vid, tmp_path):
    told = []
    session = record_flight(
        vid, RaycastRenderer, tmp_path / "flight", pictures=12, workers=1, begin=lambda what: told.append(what)
    )
    replay = Replay(session, speed=0)
    frames = [event for event in replay.events() if isinstance(event, Frame)]
    assert len(frames) == 12 and all(frame.image.shape == (96, 96, 3) for frame in frames)
    np.testing.assert_allclose(np.diff([f.stamp.t_mono_s for f in frames]), 1 / RATE_HZ, atol=0.02)
    assert sorted(r.frame for r in replay.results()) == list(range(12))
    assert [path.name for path in (tmp_path / "flight").iterdir()] == ["session"]
    assert len(told) == 2 and "12 pictures" in told[0]
    with pytest.raises(InputError, match="exists already"):
        record_flight(vid, RaycastRenderer, tmp_path / "flight", pictures=2, workers=1)
