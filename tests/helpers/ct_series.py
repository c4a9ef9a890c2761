"""A DICOM series on disk, and what was written into it."""

from dataclasses import dataclass
from pathlib import Path

from ursnav_torch.exports import Study
from ursnav_torch.segmentation import Scan


@dataclass(frozen=True)
class Ct:
    folder: Path
    scan: Scan
    study: Study
