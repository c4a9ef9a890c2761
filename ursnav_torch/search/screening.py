"""The coarse stage of a large VID: all views by a few numbers each, and those that are left exactly."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ursnav_torch.search.scan import RollScan
from ursnav_torch.search.settings import SearchSettings
from ursnav_torch.threads import map_chunks
from ursnav_torch.vid import Vid

#: Rolls at which the coarse stage compares; it holds nothing finer than some 15 cycles around the axis.
_ROLLS = 36
#: Views whose scores at all rolls stay in the second-level cache.
_VIEWS_A_CHUNK = 2_048
#: Views that the coarse stage passes on, times those that the exact scan passes on.
_MARGIN = 2


class ScreenedViews:
    """The views of a VID that has a `vid.Screen`; none but the likeliest of them are read.

    Args:
        vid: with its screen.
        settings: weights of the cues, and how many views the exact scan passes on.

    Memory: 8 V K bytes (0.1 GB for 100,000 views), and what is read of the mapped features.
    """

    def __init__(self, vid: Vid, settings: SearchSettings) -> None:
        assert vid.screen is not None
        self._vid, self._screen = vid, vid.screen
        self._weight = settings.channel_weights(vid.features.maps.shape[1])
        self._count = min(_MARGIN * settings.scan_finalists, len(vid))
        self._table = vid.screen.table.float()

    def scores(self, maps: Tensor) -> Tensor:
        """About what `RollScan.scan` would score every view (V,), for a query's maps (C, R, A)."""
        rows = self._screen.basis.turned(maps.float() * self._weight[:, None, None], _ROLLS)
        out = torch.empty(len(self._vid))

        def work(part: slice) -> None:
            torch.amax(rows @ self._table[:, part], 0, out=out[part])

        map_chunks(work, len(out), _VIEWS_A_CHUNK, float(rows.numel()) * len(out))
        return out

    def likeliest(self, maps: Tensor) -> NDArray[np.int64]:
        """The views (M,) worth an exact scan for a query's maps (C, R, A), the likeliest first."""
        return self.scores(maps).topk(self._count).indices.numpy()

    def exactly(self, views: NDArray[np.int64]) -> RollScan:
        """The exact scan of some views (K,), proven by their checksums.

        Raises:
            InputError: one was changed after the VID was built.
        """
        self._screen.prove(self._vid.features, views, self._vid.folder)
        return RollScan(self._vid.features.maps[torch.from_numpy(views)], self._weight)
