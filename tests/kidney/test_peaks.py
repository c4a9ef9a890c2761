import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import find_peaks, peak_prominences
from scipy.sparse import diags_array

from ursnav_torch.kidney.peaks import prominent_peaks


def path_graph(n: int) -> object:
    return diags_array([np.ones(n - 1), np.ones(n - 1)], offsets=[-1, 1]).tocsr()


@given(st.permutations(range(40)))
def test_on_a_line_peaks_and_prominences_are_those_of_scipy(order: list[int]) -> None:
    height = np.array(order, float)
    peaks, prominence = prominent_peaks(height, path_graph(40), 0.0)  # type: ignore[arg-type]
    padded = np.concatenate([[-100.0], height, [-100.0]])
    expected, _ = find_peaks(padded)
    sizes = peak_prominences(padded, expected)[0]
    sizes[padded[expected].argmax()] = np.inf
    assert dict(zip(peaks.tolist(), prominence.tolist(), strict=True)) == dict(
        zip((expected - 1).tolist(), sizes.tolist(), strict=True)
    )


def test_small_peaks_are_left_out_and_the_rest_sorted() -> None:
    height = np.array([0.0, 3, 2, 2.5, 0, 9, 1, 5, 0])
    peaks, prominence = prominent_peaks(height, path_graph(9), 1.0)  # type: ignore[arg-type]
    assert peaks.tolist() == [5, 7, 1]
    assert prominence.tolist() == [np.inf, 4.0, 3.0]
