"""A CT series around the phantom, with the phantom's coordinates taken for LPS."""

import numpy as np
import pytest
from ct_series import Ct
from scipy.spatial.transform import Rotation

from ursnav_torch.exports import read_study
from ursnav_torch.kidney import Kidney
from ursnav_torch.segmentation import Scan, write_dicom
from ursnav_torch.segmentation.scans import transform_of_voxels


@pytest.fixture(scope="session")
def ct(phantom: Kidney, tmp_path_factory: pytest.TempPathFactory) -> Ct:
    """Oblique slices, voxels of three lengths, and another size along every axis: nothing may be mixed up."""
    pytest.importorskip("highdicom")
    R = Rotation.from_euler("xyz", [5, -8, 12], degrees=True).as_matrix()
    spacing, size = np.array([0.8, 0.7, 1.0]), np.array([100, 90, 80])
    origin = phantom.mesh.bounds.mean(axis=0) - R @ (spacing * (size - 1) / 2)
    scan = Scan(np.zeros(size, np.int16), transform_of_voxels(spacing, R, origin, "ct"), "ct")
    folder = tmp_path_factory.mktemp("ct")
    write_dicom(scan, folder)
    return Ct(folder, scan, read_study(folder))
