"""EM samples as readings: what is in mm of the EM frame becomes mm of the kidney."""

import json
from pathlib import Path

import numpy as np
import pytest

from ursnav_torch.registration import readings_in_kidney
from ursnav_torch.registration.readings import BREATH_MM, SENSOR_MM


@pytest.mark.parametrize("scale", [1.0, 1.8])
def test_a_fitted_scale_is_that_of_the_sensors_offset_and_noise_too(tmp_path: Path, scale: float) -> None:
    path = tmp_path / "registration.json"
    path.write_text(json.dumps({"R": np.eye(3).tolist(), "t_mm": [10.0, 0.0, 0.0], "scale": scale}))
    reading, unseen = readings_in_kidney(path, [0.0, 1.0, -4.0])([[1.0, 2.0, 3.0], [np.nan] * 3])
    assert reading is not None and unseen is None
    np.testing.assert_allclose(reading.position_mm, scale * np.array([1.0, 2.0, 3.0]) + [10.0, 0.0, 0.0])
    np.testing.assert_allclose(reading.offset_camera_mm, scale * np.array([0.0, 1.0, -4.0]))
    assert reading.sigma_mm == pytest.approx(np.sqrt(((scale * SENSOR_MM) ** 2 + BREATH_MM**2) / 3))
