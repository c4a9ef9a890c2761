"""The page in the browser: live navigation, and a kidney to fly through. It observes and passes on what is pressed;
without it everything works the same.
"""

from ursnav_torch.page.explore import ExplorePage, explore_vid
from ursnav_torch.page.live import LivePage, web_page
from ursnav_torch.page.pictures import PagePictures
from ursnav_torch.page.server import PageServer, check_address

__all__ = [
    "ExplorePage",
    "LivePage",
    "PagePictures",
    "PageServer",
    "check_address",
    "explore_vid",
    "web_page",
]
