"""A kidney that has moved and swollen since its scan: smooth warps, breathing, distension by irrigation.

Amplitudes: the kidney moves about 11 mm (5-16 mm) with quiet breathing, nearly as a whole (Davies et al., Br J
Radiol 67:1096, 1994); irrigation and the scope change the collecting system's shape by millimeters.
"""

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial.transform import Rotation

from ursnav_torch.errors import InputError
from ursnav_torch.geometry import Array, check_rigid, transform_from
from ursnav_torch.rendering.raycast import RayScene

_WAVES = 6
_AROUND_MM = 6.0  # wall within about this distance carries the camera along
_SMOOTHING_ROUNDS = 30
_LARGEST_RADIUS_MM = 15.0


@dataclass(frozen=True, slots=True)
class WarpSettings:
    """How much the kidney changes.

    Args:
        amplitude_mm: root mean square over the mesh of the smooth displacement's length; 0 to 2.5 typical.
        wavelength_mm: size of the smooth displacement's waves.
        shift_mm: motion as a whole in a random direction, up to 11 for breathing.
        distension: growth of the lumen's local radius, 0 to 0.1.
    """

    amplitude_mm: float = 1.5
    wavelength_mm: float = 45.0
    shift_mm: float = 0.0
    distension: float = 0.0

    def __post_init__(self) -> None:
        if min(self.amplitude_mm, self.shift_mm) < 0 or not -0.3 <= self.distension <= 0.3 or self.wavelength_mm <= 0:
            raise InputError(
                "A warp needs amplitude_mm >= 0, shift_mm >= 0, wavelength_mm > 0 and distension in -0.3..0.3; "
                f"got {self}."
            )
        if self.amplitude_mm > self.wavelength_mm / 12:
            raise InputError(
                f"amplitude_mm={self.amplitude_mm} folds a wall that waves over wavelength_mm={self.wavelength_mm}; "
                "keep the amplitude below a twelfth of the wavelength."
            )


@dataclass(frozen=True)
class Deformation:
    """A warped kidney.

    Attributes:
        rest_vertices: (V, 3) mm, before.
        mesh: after; same faces, same frame.
        unit_mm: length of 1 mm of anatomy: the kidney's scale.
    """

    rest_vertices: Array
    mesh: trimesh.Trimesh
    unit_mm: float = 1.0

    def carry(self, T_kidney_camera: NDArray[np.float64]) -> Array:
        """Where the camera must be in the warped kidney to stand as it did in the rest kidney.

        Args:
            T_kidney_camera: (4, 4), in the rest kidney: what a VID of the scan should answer.

        Returns:
            (4, 4) pose in the warped kidney's mesh, from which to draw the picture: the rigid motion of the wall
            around the camera (weighted least squares, Gaussian weights) applied to the pose.
        """
        T = check_rigid(T_kidney_camera, "T_kidney_camera")
        away = np.linalg.norm(self.rest_vertices - T[:3, 3], axis=1)
        weight = np.exp(-(away**2 - away.min() ** 2) / (2 * (_AROUND_MM * self.unit_mm) ** 2))
        weight /= weight.sum()
        moved = np.asarray(self.mesh.vertices)
        center, center_moved = weight @ self.rest_vertices, weight @ moved
        near = weight > 1e-6 * weight.max()
        R = Rotation.align_vectors(moved[near] - center_moved, self.rest_vertices[near] - center, weight[near])[0]
        T_warped_rest = transform_from(R.as_matrix(), center_moved - R.as_matrix() @ center)
        return T_warped_rest @ T


def deform_mesh(
    mesh: trimesh.Trimesh, settings: WarpSettings, rng: np.random.Generator, unit_mm: float = 1.0
) -> Deformation:
    """Warp a lumen at random.

    Args:
        mesh: the rest kidney, mm, normals outward.
        settings: how much, lengths in mm of this kidney.
        rng: draws the waves and the direction of the shift.
        unit_mm: length of 1 mm of anatomy: the kidney's scale.
    """
    rest = np.asarray(mesh.vertices, float)
    moved = rest + settings.distension * local_radius(mesh, unit_mm)[:, None] * np.asarray(mesh.vertex_normals)
    if settings.amplitude_mm > 0:
        waves = _smooth_waves(rest, settings.wavelength_mm, rng)
        rms = np.sqrt(np.mean(np.sum(waves**2, axis=1)))
        moved = moved + settings.amplitude_mm / rms * waves
    direction = rng.standard_normal(3)
    moved = moved + settings.shift_mm * direction / np.linalg.norm(direction)
    return Deformation(rest, trimesh.Trimesh(moved, mesh.faces, process=False), unit_mm)


def local_radius(mesh: trimesh.Trimesh, unit_mm: float = 1.0) -> Array:
    """(V,) mm: half the way across the lumen from each vertex, at most 15 mm of anatomy, averaged over the
    neighborhood."""
    vertices, inward = np.asarray(mesh.vertices), -np.asarray(mesh.vertex_normals)
    across, _ = RayScene(mesh).cast(vertices + 0.01 * inward, inward)
    radius = np.minimum(np.nan_to_num(across, posinf=0.0) / 2, _LARGEST_RADIUS_MM * unit_mm).astype(float)
    a, b = np.asarray(mesh.edges_unique).T
    ones = np.ones(len(a))
    neighbors = sparse.csr_array((ones, (a, b)), shape=(len(vertices),) * 2)
    neighbors = neighbors + neighbors.T + sparse.eye_array(len(vertices))
    average = sparse.diags_array(1 / neighbors.sum(axis=1)) @ neighbors
    for _ in range(_SMOOTHING_ROUNDS):
        radius = average @ radius
    return radius


def _smooth_waves(points_mm: Array, wavelength_mm: float, rng: np.random.Generator) -> Array:
    """Displacements (N, 3) of random size: a few plane waves of 1 to 2 wavelengths in random directions."""
    displacement = np.zeros_like(points_mm)
    for _ in range(_WAVES):
        along, push = rng.standard_normal(3), rng.standard_normal(3)
        along *= 2 * np.pi / (wavelength_mm * rng.uniform(1, 2) * np.linalg.norm(along))
        displacement += np.sin(points_mm @ along + rng.uniform(0, 2 * np.pi))[:, None] * push
    return displacement
