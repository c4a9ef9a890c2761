from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from ursnav_torch.kidney import Kidney, load_mesh_kidney, make_phantom_kidney
from ursnav_torch.kidney.grid import LumenGrid
from ursnav_torch.kidney.pelvis import find_pelvis
from ursnav_torch.kidney.tips import find_tips


def paired(found: NDArray[np.float64], true: NDArray[np.float64], within_mm: float) -> int:
    """How many true tips (C, 3) have their own found one within a distance."""
    near = np.linalg.norm(found[:, None] - true, axis=-1) <= within_mm
    return int(near[linear_sum_assignment(near, maximize=True)].sum())


def found_in(kidney: Kidney) -> NDArray[np.float64]:
    grid = LumenGrid.from_mesh(kidney.mesh, 0.5 * kidney.scale)
    return find_tips(grid, find_pelvis(grid, kidney.scale), kidney.scale)


def test_every_calyx_of_a_phantom_is_found_and_neither_pelvis_nor_ureter(phantom: Kidney) -> None:
    found = found_in(phantom)
    assert paired(found, phantom.tips_mm, 6.0) == len(phantom.calyces)
    assert len(found) <= len(phantom.calyces) + 2
    assert found[:, 0].min() > -8  # the ureter ends at x < -14


def test_the_pelvis_is_found(phantom: Kidney) -> None:
    assert np.linalg.norm(find_pelvis(LumenGrid.from_mesh(phantom.mesh, 0.5), 1.0)) < 8


def test_a_printed_phantom_has_the_same_calyces(phantom: Kidney) -> None:
    small, large = found_in(phantom), found_in(phantom.scaled(1.8))
    assert len(small) == len(large) == paired(large, 1.8 * small, 3.0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [10, 11])
def test_calyces_of_many_phantoms_are_found(seed: int) -> None:
    kidney = make_phantom_kidney(seed)
    found = found_in(kidney)
    assert paired(found, kidney.tips_mm, 6.0) == len(kidney.calyces)
    assert len(found) <= len(kidney.calyces) + 2


@pytest.mark.parametrize("kidney", ["F_R", "M_R"])
def test_every_given_tip_of_a_real_kidney_has_its_own_found_one(data: Path, kidney: str) -> None:
    given = load_mesh_kidney(data / kidney / "lumen.stl", data / kidney / "calyces.csv")
    found = load_mesh_kidney(data / kidney / "lumen.stl")
    assert paired(found.tips_mm, given.tips_mm, 6.0) == len(given.calyces)
    assert len(found.calyces) <= len(given.calyces) + 2
