"""The percentile that sets a drawing's exposure."""

import numpy as np
import pytest

from ursnav_torch.rendering import percentile


@pytest.mark.parametrize("count", [1, 2, 10, 1257])
@pytest.mark.parametrize("q", [0.0, 37.0, 90.0, 100.0])
def test_it_is_numpys(count: int, q: float) -> None:
    values = np.random.default_rng(count).normal(size=(3, count))
    np.testing.assert_allclose(percentile(values, q), np.percentile(values, q, axis=-1), atol=1e-12)
