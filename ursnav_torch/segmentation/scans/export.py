"""Scans into files, as `read` reads them back: NIfTI, NRRD, MetaImage, or a folder of DICOM slices."""

from pathlib import Path
from typing import Any

import numpy as np

from ursnav_torch.segmentation.scans.read import simple_itk
from ursnav_torch.segmentation.scans.scan import Scan


def write_scan(scan: Scan, path: Path) -> None:
    """Write NIfTI, NRRD or MetaImage, as the suffix says."""
    sitk = simple_itk()
    sitk.WriteImage(as_image(scan), str(path), useCompression=path.suffix == ".gz")


def write_dicom(scan: Scan, folder: Path, series: str = "1.2.826.0.1.3680043.8.498.1") -> None:
    """Write a DICOM series, a file a slice, into a folder; ``series`` is its UID."""
    sitk = simple_itk()
    image, T = as_image(scan), scan.T_lps_voxel
    folder.mkdir(parents=True, exist_ok=True)
    cosines = (T[:3, :3] / scan.spacing_mm).T
    writer = sitk.ImageFileWriter()
    writer.KeepOriginalImageUIDOn()
    for k in range(scan.voxels.shape[2]):
        plane = image[:, :, k]
        tags = {
            "0008|0060": "CT",
            "0008|0016": "1.2.840.10008.5.1.4.1.1.2",
            "0008|0018": f"{series}.{k + 1}",
            "0008|103e": "synthetic urography",
            "0010|0020": "synthetic",
            "0020|0010": "1",
            "0020|000d": f"{series}.0",
            "0020|000e": series,
            "0020|0013": str(k + 1),
            "0020|0032": "\\".join(f"{v:.6f}" for v in scan.to_lps([0, 0, k])),
            "0020|0052": f"{series}.9",
            "0020|0037": "\\".join(f"{v:.8f}" for v in (*cosines[0], *cosines[1])),
            "0018|0050": f"{scan.spacing_mm[2]:.6f}",
            "0028|1052": "-1024",
            "0028|1053": "1",
        }
        for key, value in tags.items():
            plane.SetMetaData(key, value)
        writer.SetFileName(str(folder / f"slice_{k:04d}.dcm"))
        writer.Execute(plane)


def as_image(scan: Scan) -> Any:
    """The scan as a SimpleITK image."""
    sitk = simple_itk()
    image = sitk.GetImageFromArray(np.ascontiguousarray(scan.voxels.transpose(2, 1, 0)))
    image.SetSpacing(scan.spacing_mm.tolist())
    image.SetDirection((scan.T_lps_voxel[:3, :3] / scan.spacing_mm).ravel().tolist())
    image.SetOrigin(scan.T_lps_voxel[:3, 3].tolist())
    return image
