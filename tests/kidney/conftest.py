import numpy as np
import pytest
import trimesh


@pytest.fixture(scope="session")
def elbow() -> trimesh.Trimesh:
    """A square channel, 4 mm wide, that turns by 90 degrees at the edge (4, 4): 20 mm along x, then 20 mm along y."""
    outline = np.array([[0, 0], [20, 0], [20, 4], [4, 4], [4, 20], [0, 20]], float)
    triangles = np.array([[0, 1, 3], [1, 2, 3], [0, 3, 5], [3, 4, 5]])
    low, high = (np.column_stack([outline, np.full(6, z)]) for z in (0.0, 4.0))
    side = [[(a, b, b + 6), (a, b + 6, a + 6)] for a, b in zip(range(6), [1, 2, 3, 4, 5, 0], strict=True)]
    faces = np.concatenate([triangles[:, ::-1], triangles + 6, np.reshape(side, (-1, 3))])
    return trimesh.Trimesh(np.concatenate([low, high]), faces, process=False)
