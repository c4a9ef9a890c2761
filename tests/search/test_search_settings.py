"""What the cues of a search weigh."""

import pytest
import torch

from ursnav_torch.search import SearchSettings


@pytest.mark.parametrize("channels", [3, 5])
def test_a_perfect_fit_of_relief_and_directions_scores_their_weights(channels: int) -> None:
    """The directions' weight is shared by its pairs of channels, each pair a correlation of 1 at best."""
    settings = SearchSettings(relief_weight=1.5, direction_weight=2.0)
    weight = settings.channel_weights(channels)
    assert weight[0] == 1.5 and settings.map_weight == 3.5
    torch.testing.assert_close(weight[1::2], weight[2::2])
    assert float(weight[0] + weight[1::2].sum()) == pytest.approx(settings.map_weight)


def test_relief_alone_takes_all_the_weight() -> None:
    assert SearchSettings(relief_weight=1.0, direction_weight=0.0).channel_weights(1).tolist() == [1.0]
