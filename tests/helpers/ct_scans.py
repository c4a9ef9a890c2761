"""Scans for the tests of kidney=ct."""

from dataclasses import replace

import numpy as np
import trimesh
from scipy import ndimage

from ursnav_torch.kidney import Kidney
from ursnav_torch.kidney.grid import distance_to_surface
from ursnav_torch.segmentation import Patient, Scan, place_kidney, synthetic_ct


def small_ct(kidney: Kidney, side: str = "right", **settings: object) -> tuple[Scan, Patient]:
    """A scan of 210 x 210 x 110 mm around one kidney, and the truth in it."""
    patient = place_kidney(kidney, side)
    return synthetic_ct([patient], **{"size": (300, 300, 110), **settings}), patient  # type: ignore[arg-type]


def with_stone(scan: Scan, center_lps: np.ndarray, size_mm: float, hu: float, blur_mm: float = 0.5) -> Scan:
    """The same scan with a ball of stone in it, as sharp as the scanner is."""
    fine = 4
    reach = (size_mm / 2 + 4 * blur_mm) / scan.spacing_mm
    at = scan.to_voxel(center_lps)
    low, high = np.floor(at - reach).astype(int), np.ceil(at + reach).astype(int) + 1
    axes = [(np.arange(a * fine, b * fine) + 0.5) / fine - 0.5 for a, b in zip(low, high, strict=True)]
    points = scan.to_lps(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1))
    inside = (np.linalg.norm(points - center_lps, axis=-1) < size_mm / 2).astype(np.float32)
    inside = ndimage.gaussian_filter(inside, blur_mm * fine / scan.spacing_mm)
    share = inside.reshape(*(n for m in inside.shape for n in (m // fine, fine))).mean(axis=(1, 3, 5))
    voxels = scan.voxels.copy()
    part = voxels[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
    part[...] = np.rint(part + share * (hu - part)).astype(part.dtype)
    return replace(scan, voxels=voxels)


def turned(scan: Scan, T_a_lps: np.ndarray) -> Scan:
    """The same voxels in another place and direction."""
    return replace(scan, T_lps_voxel=T_a_lps @ scan.T_lps_voxel)


def flipped(scan: Scan, axis: int) -> Scan:
    """The same scan, stored the other way round along one axis."""
    T = scan.T_lps_voxel.copy()
    T[:3, 3] = scan.to_lps(np.eye(3)[axis] * (scan.voxels.shape[axis] - 1))
    T[:3, axis] *= -1
    return Scan(np.flip(scan.voxels, axis), T, scan.source)


def labels_of(patient: Patient, scan: Scan, label: int = 1) -> Scan:
    """The label map of the true lumen on a scan's grid."""
    fine = np.eye(4)
    fine[:3, :3] *= 0.35
    fine[:3, 3] = patient.origin_lps
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in scan.voxels.shape), indexing="ij"), axis=-1)
    at = np.rint(Scan(patient.fraction, fine, "").to_voxel(scan.to_lps(grid))).astype(int)
    there = np.all((at >= 0) & (at < patient.fraction.shape), axis=-1)
    at = np.clip(at, 0, np.array(patient.fraction.shape) - 1)
    inside = there & (patient.fraction[at[..., 0], at[..., 1], at[..., 2]] > 0.5)
    return Scan((inside * label).astype(np.int16), scan.T_lps_voxel, "label map", {})


def between(a: trimesh.Trimesh, b: trimesh.Trimesh) -> np.ndarray:
    """Distances in mm of points spread over either surface to the other."""
    sides = ((a, b), (b, a))
    return np.concatenate(
        [distance_to_surface(to, trimesh.sample.sample_surface(of, 6000, seed=1)[0], 0.5) for of, to in sides]
    )
