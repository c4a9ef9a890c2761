"""A CT urography of a made-up patient: a kidney of known shape in a body with spine, ribs, fat and noise.

For tests, benchmarks and trying out: what comes out of the segmentation can be held against the kidney that went in.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from ursnav_torch.geometry import apply
from ursnav_torch.kidney.anatomy import Kidney
from ursnav_torch.kidney.grid import fill
from ursnav_torch.segmentation.scans.scan import Scan, transform_of_voxels

Array = NDArray[np.float64]

#: Densities, Hounsfield units.
AIR, FAT, MUSCLE, RENAL, MARROW, BONE, DISC, VESSEL = -1000, -95, 45, 165, 220, 650, 85, 135
#: The phantom's axes (lateral, anterior, superior) of a right and of a left kidney in LPS, and where its pelvis lies.
_AXES = {"right": np.diag([-1.0, -1.0, 1.0]), "left": np.diag([1.0, -1.0, 1.0])}
_PELVIS_LPS = {"right": np.array([-38.0, 5.0, 0.0]), "left": np.array([38.0, 5.0, 6.0])}
#: Half axes of the body and of a kidney, mm; the rim of fat under the skin.
_BODY, _KIDNEY, _RIM_MM = np.array([165.0, 105.0]), np.array([27.0, 25.0, 52.0]), 18.0
_GRID_MM = 0.35


@dataclass(frozen=True, slots=True, eq=False)
class Patient:
    """A kidney where it lies in the patient.

    Attributes:
        mesh: its lumen in LPS, mm, normals outward.
        tips_lps: (C, 3) tips of its calyces.
        fraction: (X, Y, Z) float32, how much of a fine voxel is lumen, blurred as a scanner does.
        origin_lps: (3,) center of fine voxel (0, 0, 0).
        center_lps: (3,) middle of the renal tissue.
    """

    mesh: trimesh.Trimesh
    tips_lps: Array
    fraction: NDArray[np.float32]
    origin_lps: Array
    center_lps: Array


def place_kidney(kidney: Kidney, side: str = "right", blur_mm: float = 0.5) -> Patient:
    """Put a phantom into the patient; ``blur_mm`` is the scanner's (standard deviation)."""
    R, at = _AXES[side], _PELVIS_LPS[side]
    mesh = trimesh.Trimesh(kidney.mesh.vertices @ R.T + at, kidney.mesh.faces, process=False)
    if mesh.volume < 0:
        mesh.invert()
    tips = kidney.tips_mm @ R.T + at
    origin = mesh.vertices.min(axis=0) - 8 * _GRID_MM
    shape = np.ceil((mesh.vertices.max(axis=0) - origin) / _GRID_MM + 8).astype(int)
    inside = fill((mesh.triangles - origin) / _GRID_MM, shape)
    fraction = ndimage.gaussian_filter(inside.astype(np.float32), blur_mm / _GRID_MM)
    return Patient(mesh, tips, fraction, origin, tips.mean(axis=0) + R @ (-4.0, 0.0, 0.0))


def synthetic_ct(
    patients: Sequence[Patient],
    spacing_mm: ArrayLike = (0.7, 0.7, 1.0),
    size: ArrayLike = (512, 512, 130),
    direction: ArrayLike | None = None,
    contrast_hu: float = 900.0,
    noise_hu: float = 18.0,
    seed: int = 0,
) -> Scan:
    """An abdomen with one kidney or two, scanned on a grid around the spine.

    Args:
        patients: from `place_kidney`.
        spacing_mm: (3,) of the voxels.
        size: (3,) voxels along each axis.
        direction: (3, 3) direction cosines, a column an axis; LPS axes when None.
        contrast_hu: density of the urine; 12 is a scan before it is excreted.
        noise_hu: standard deviation.
        seed: of the noise.
    """
    shape = np.asarray(size, int)
    R = np.eye(3) if direction is None else np.asarray(direction, float)
    middle = np.array([0.0, 10.0, np.mean([p.center_lps[2] for p in patients]) if patients else 0.0])
    origin = middle - R @ (np.asarray(spacing_mm, float) * (shape - 1) / 2)
    T = transform_of_voxels(spacing_mm, R, origin, "synthetic CT")
    rng = np.random.default_rng(seed)
    voxels = np.empty(shape[::-1], np.int16)
    x, y = np.meshgrid(np.arange(shape[0]), np.arange(shape[1]))
    for k in range(shape[2]):
        points = apply(T, np.stack([x, y, np.full_like(x, k)], axis=-1).astype(float))
        hu = _body(points)
        for patient in patients:
            _add_kidney(hu, points, patient, contrast_hu)
        noise = rng.standard_normal(hu.shape, np.float32) * noise_hu if noise_hu else 0.0
        voxels[k] = np.clip(hu + noise, -1024, 3071)
    return Scan(voxels.transpose(2, 1, 0), T, "synthetic CT")


def _body(points: Array) -> NDArray[np.float32]:
    """Densities without the kidneys at points (..., 3), LPS: skin, fat, muscle, vertebrae, discs, ribs, aorta."""
    x, y, z = (points[..., i].astype(np.float32) for i in range(3))
    out = np.sqrt((x / _BODY[0]) ** 2 + (y / _BODY[1]) ** 2)
    hu = np.full(x.shape, AIR, np.float32)
    hu[out < 1] = FAT
    hu[out < 1 - _RIM_MM / _BODY[1]] = MUSCLE
    behind = np.hypot(x, y - 48)
    in_body = np.abs((z + 1000) % 36 - 18) < 14
    spine = behind < 21
    hu[spine] = np.where(in_body, np.where(behind > 18.5, BONE, MARROW), DISC)[spine]
    hu[np.hypot(x + 9, y - 15) < 9] = VESSEL
    wall = 0.86 + 0.02 * np.sin(z / 9)
    rib = np.hypot((out - wall) * _BODY[1], (z - 0.35 * np.abs(x) + 1000) % 26 - 13)
    ribs = (y > -60) & (np.abs(x) > 25)
    hu[ribs & (rib < 6)] = BONE
    hu[ribs & (rib < 4)] = MARROW
    return hu


def _add_kidney(hu: NDArray[np.float32], points: Array, patient: Patient, contrast_hu: float) -> None:
    """Set renal tissue, sinus fat and the filled lumen of one kidney."""
    off = points - patient.center_lps
    near = np.linalg.norm(off / (_KIDNEY + 12.0), axis=-1) < 1
    near |= np.all(
        (points > patient.origin_lps) & (points < patient.origin_lps + _GRID_MM * np.array(patient.fraction.shape)),
        axis=-1,
    )
    if not near.any():
        return
    there, off = points[near], off[near]
    values = hu[near]
    soft = (values > -300) & (values < BONE - 1) & (values != MARROW)
    out = np.linalg.norm(off / _KIDNEY, axis=-1)
    values[soft & (out < 1.25)] = FAT
    values[soft & (out < 1)] = RENAL
    medial = -np.sign(patient.center_lps[0]) * off[:, 0]
    sinus = np.linalg.norm((off - [-np.sign(patient.center_lps[0]) * 14, 0, 0]) / (19.0, 13.0, 24.0), axis=-1) < 1
    values[soft & sinus & (medial > -6)] = FAT
    fraction = ndimage.map_coordinates(
        patient.fraction, ((there - patient.origin_lps) / _GRID_MM).T, order=1, mode="constant"
    )
    hu[near] = values + fraction * (contrast_hu - values)
