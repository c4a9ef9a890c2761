"""The page in the browser: live navigation, and a kidney to fly through. It observes and passes on what is pressed;
without it everything works the same.
"""

from ursnav_torch.viewer.page.explore import ExplorePage, explore_vid
from ursnav_torch.viewer.page.live import LivePage, web_page
from ursnav_torch.viewer.page.pictures import Pictures
from ursnav_torch.viewer.page.scene import KidneyScene
from ursnav_torch.viewer.page.server import check_address, start_server

__all__ = [
    "ExplorePage",
    "KidneyScene",
    "LivePage",
    "Pictures",
    "check_address",
    "explore_vid",
    "start_server",
    "web_page",
]
