"""The result of a registration: its error over the kidney and its file."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ursnav_torch.errors import InputError
from ursnav_torch.registration import Registration, register_landmarks
from ursnav_torch.registration.result import skew


def noisy(seed: int = 0, n: int = 8, fle_mm: float = 1.5) -> tuple[Registration, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    em = rng.normal(0, [30, 15, 8], (n, 3))
    R, t = Rotation.random(rng=rng).as_matrix(), rng.normal(0, 100, 3)
    kidney = em @ R.T + t
    return register_landmarks(em, kidney + rng.normal(0, fle_mm / 3**0.5, (n, 3))), em, kidney


def fitzpatrick(fle2: float, landmarks: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """TRE by principal axes: FLE^2 / N (1 + 1/3 sum_k d_k^2 / f_k^2); Fitzpatrick, West, Maurer 1998, Eq. 46."""
    center = landmarks.mean(0)
    axes = np.linalg.svd(landmarks - center)[2]
    p, x = (landmarks - center) @ axes.T, (targets - center) @ axes.T
    ratio = 0.0
    for k in range(3):
        others = [j for j in range(3) if j != k]
        ratio = ratio + (x[:, others] ** 2).sum(1) / (p[:, others] ** 2).sum(1).mean()
    return np.sqrt(fle2 / len(landmarks) * (1 + ratio / 3))


def test_tre_equals_the_formula_of_fitzpatrick() -> None:
    found, em, _ = noisy()
    targets = np.random.default_rng(1).normal(0, 40, (20, 3))
    fle2 = found.fre_rmse_mm**2 * found.n / (found.n - 2)
    np.testing.assert_allclose(found.tre_mm(targets), fitzpatrick(fle2, found.apply(em), targets), rtol=1e-9)


def test_tre_agrees_with_the_error_made() -> None:
    target = np.array([[40.0, -20.0, 5.0]])
    squared, predicted = [], []
    for seed in range(400):
        rng = np.random.default_rng(seed)
        em = np.random.default_rng(5).normal(0, 20, (8, 3))
        found = register_landmarks(em, em + rng.normal(0, 1, (8, 3)))
        squared.append(np.sum((found.apply(target) - target) ** 2))
        predicted.append(found.tre_mm(target)[0] ** 2)
    assert np.mean(predicted) == pytest.approx(np.mean(squared), rel=0.12)


def test_skew_is_the_cross_product() -> None:
    a, b = np.random.default_rng(0).normal(size=(2, 5, 3))
    np.testing.assert_allclose(np.einsum("nij,nj->ni", skew(a), b), np.cross(a, b))


def test_json_holds_the_contract_and_comes_back(tmp_path: Path) -> None:
    found, em, _ = noisy()
    found.to_json(tmp_path / "r.json")
    data = json.loads((tmp_path / "r.json").read_text(encoding="utf-8"))
    assert {"R", "t_mm", "scale", "n", "fre_rmse_mm", "fre_mm", "tre_loo_rmse_mm", "from", "to"} <= data.keys()
    assert (data["from"], data["to"], data["n"], len(data["fre_mm"])) == ("em", "kidney", 8, 8)
    again = Registration.from_json(tmp_path / "r.json")
    np.testing.assert_array_equal(again.apply(em), found.apply(em))
    np.testing.assert_array_equal(again.tre_mm(em), found.tre_mm(em))
    assert again.fre_rmse_mm == found.fre_rmse_mm and again.method == "landmarks"


def test_unknown_leave_one_out_is_null(tmp_path: Path) -> None:
    em = np.random.default_rng(0).normal(0, 20, (3, 3))
    register_landmarks(em, em + 1).to_json(tmp_path / "r.json")
    data = json.loads((tmp_path / "r.json").read_text(encoding="utf-8"))
    assert data["tre_loo_rmse_mm"] is None and data["tre_loo_mm"] == [None, None, None]
    assert Registration.from_json(tmp_path / "r.json").tre_loo_rmse_mm is None


def test_a_plain_transform_is_enough_and_has_its_leave_one_out_error_everywhere(tmp_path: Path) -> None:
    (tmp_path / "r.json").write_text('{"R": [[1,0,0],[0,1,0],[0,0,1]], "t_mm": [1,2,3], "tre_loo_rmse_mm": 2.0}')
    found = Registration.from_json(tmp_path / "r.json")
    np.testing.assert_array_equal(found.apply([0, 0, 0]), [1, 2, 3])
    np.testing.assert_allclose(found.tre_mm([[0, 0, 0], [50, 0, 0]]), 2.0)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"R": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}, "mirrors space"),
        ({"R": [[2, 0, 0], [0, 2, 0], [0, 0, 2]]}, "not orthonormal"),
        ({"R": [1, 0, 0]}, r"Expected `array`, got `int` - at `\$.R\[0\]`"),
        ({"t_mm": [1, 2]}, r"length 3, got 2 - at `\$.t_mm`"),
        ({"t_mm": ["a", "b", "c"]}, r"not a registration.*got `str` - at `\$.t_mm\[0\]`"),
        ({"scale": 0}, "positive"),
        ({"from": "kidney", "to": "em"}, "Invert it first"),
        ({"covariance": (-np.eye(6)).tolist(), "center_mm": [0, 0, 0]}, "semidefinite"),
    ],
)
def test_files_that_are_no_registration_are_refused(tmp_path: Path, change: dict, match: str) -> None:
    data = {"R": np.eye(3).tolist(), "t_mm": [0, 0, 0]} | change
    (tmp_path / "r.json").write_text(json.dumps(data))
    with pytest.raises(InputError, match=match):
        Registration.from_json(tmp_path / "r.json")


@pytest.mark.parametrize("text", ["", "[]", '{"R": 1}', "no json"])
def test_text_that_is_no_registration_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "r.json").write_text(text)
    with pytest.raises(InputError, match="registration"):
        Registration.from_json(tmp_path / "r.json")


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no registration file .*none\.json"):
        Registration.from_json(tmp_path / "none.json")
