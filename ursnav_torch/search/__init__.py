"""Every view of the VID compared with a picture: scan at every roll and tilt, shapes of the best, ranked hypotheses."""

from ursnav_torch.search.ranking import Ranking
from ursnav_torch.search.settings import VIDEO_SEARCH, SearchSettings, default_matching
from ursnav_torch.search.view_search import ViewSearch

__all__ = ["VIDEO_SEARCH", "Ranking", "SearchSettings", "ViewSearch", "default_matching"]
