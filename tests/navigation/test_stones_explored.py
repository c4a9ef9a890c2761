"""Stones through a tracked exploration: laid in a simulated kidney, met by the scope on its own, told in a table."""

from functools import partial

import numpy as np
import pytest
from small_explorations import small_vid

from ursnav_torch.autonomy import AutonomySettings
from ursnav_torch.columns import STONE_COLUMNS
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.runs.navigate import STONES, navigate_vid
from ursnav_torch.session import rehearse
from ursnav_torch.simulation import make_twin
from ursnav_torch.simulation.stones import lay_stones
from ursnav_torch.tables import number, read_csv
from ursnav_torch.tracking.tracker import Tracker


@pytest.mark.slow
def test_the_table_of_a_tracked_exploration_holds_the_places_and_sizes_of_the_stones(
    phantom, lens, tmp_path, monkeypatch
):
    vid, out = small_vid(phantom, lens, tmp_path / "vid"), tmp_path / "explored"
    laid = lay_stones(vid.kidney, vid.lumen, 2, np.random.default_rng([0, 2]))
    monkeypatch.setattr("ursnav_torch.simulation.stones.lay_stones", lambda *given: laid)
    hardware = partial(rehearse, partial(make_twin, sensor="thesis_simulation", stones=2), rate_hz=6.0)
    told = navigate_vid(
        Tracker(vid), hardware, RaycastRenderer, out=out, duration_s=90.0, autonomy=AutonomySettings()
    )  # fmt: skip
    assert "every calyx was visited" in told and "2 stones in the lower pole" in told
    rows = read_csv(out / STONES, STONE_COLUMNS, "stones")
    assert len(laid) == len(rows) == 2, "both, and none that is not there"
    for stone in laid:
        places = np.array([[number(row, axis) for axis in ("x_mm", "y_mm", "z_mm")] for row in rows])
        nearest = int(np.linalg.norm(places - stone.center_mm, axis=1).argmin())
        row, size = rows[nearest], 2 * float(stone.radii_mm.max())
        off = float(np.linalg.norm(places[nearest] - stone.center_mm))
        assert off < min(1.5, 3 * number(row, "position_sd_mm")), "as near as a stone's place must be"
        assert number(row, "size_mm") == pytest.approx(size, abs=max(0.3 * size, 2 * number(row, "size_sd_mm")))
        assert row["calyx"] == vid.kidney.calyces[int(vid.lumen.to_calyces(stone.center_mm[None])[0].argmin())].name
        assert row["state"] == "there" and number(row, "pictures") >= 3
