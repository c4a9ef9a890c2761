"""What hands do: touch the phantom with the sensor, and look up views in the model (thesis §4.4-4.5)."""

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from ursnav_torch.geometry import Array, inverse, look_along, transform_from
from ursnav_torch.kidney import Kidney
from ursnav_torch.registration import picked_points
from ursnav_torch.simulation import EmField
from ursnav_torch.thesis.settings import ProtocolSettings


def touch_landmarks(
    kidney: Kidney, em: EmField, settings: ProtocolSettings, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Centers of the spheres on the model (N, 3), kidney frame, and the sensor's positions (N, 3), EM frame.

    The points lie as far from each other as they can on the outside of the kidney. The sensor is held against each,
    about square to the wall; on the model, a sphere of half the sensor's length is laid on the point as it was found.
    """
    points, normals = spread_points(kidney.mesh, settings.landmarks)
    sensors = []
    for point, normal in zip(points, normals, strict=True):
        axis = tilted(normal, np.radians(settings.hold_deg), rng)
        sensors.append(read_em(em, look_along(point + settings.reach_mm * axis, -axis))[0])
    picks = points + rng.normal(size=points.shape) * settings.pick_mm / 3**0.5
    return picked_points(picks, kidney.mesh, settings.reach_mm), np.array(sensors)


def spread_points(mesh: trimesh.Trimesh, count: int) -> tuple[Array, Array]:
    """Points (count, 3) on a surface and outward normals there, each the farthest from those before it."""
    points = np.asarray(mesh.triangles_center)
    chosen = [int(np.linalg.norm(points - points.mean(axis=0), axis=1).argmax())]
    distance = np.full(len(points), np.inf)
    while len(chosen) < count:
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
        chosen.append(int(distance.argmax()))
    return points[chosen], np.asarray(mesh.face_normals)[chosen]


def read_em(em: EmField, T_kidney_sensor: Array) -> tuple[Array, Array]:
    """Position (3,) and axis (3,), EM frame, that the tracker reads of a sensor at a pose (4, 4).

    A reading in which the sensor is not seen is NaN.
    """
    reading = em.read(T_kidney_sensor @ inverse(transform_from(np.eye(3), em.sensor_offset_mm)))
    if reading is None:
        return np.full(3, np.nan), np.full(3, np.nan)
    position, quaternion = reading
    return np.array(position), np.asarray(Rotation.from_quat(quaternion).as_matrix())[:, 2]


def find_views(T_kidney_camera: Array, settings: ProtocolSettings, rng: np.random.Generator) -> Array:
    """Poses (N, 4, 4) at which a hand that looks for the same view in the model ends up."""
    found = np.array(T_kidney_camera, float)
    for T in found:
        T[:3, :3] = T[:3, :3] @ _random_turn(np.radians(settings.reference_deg), rng)
        T[:3, 3] += rng.normal(size=3) * settings.reference_mm / 3**0.5
    return found


def tilted(direction: Array, angle: float, rng: np.random.Generator) -> Array:
    """A unit vector (3,) off ``direction`` by an angle whose root mean square is ``angle`` radians."""
    aside = rng.normal(size=3) * angle / 2**0.5
    aside -= (aside @ direction) * direction
    return np.asarray((direction + aside) / np.linalg.norm(direction + aside))


def _random_turn(angle: float, rng: np.random.Generator) -> Array:
    return np.asarray(Rotation.from_rotvec(rng.normal(size=3) * angle / 3**0.5).as_matrix())
