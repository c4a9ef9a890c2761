"""Exploring by itself: the order of visits, a state machine, and steering from pose and map to velocities.

Pure logic without devices; `navigation` gives it poses and hands its wishes to the robot, as it does an operator's.
"""

from ursnav_torch.autonomy.explorer import Explorer
from ursnav_torch.autonomy.perception import Perception, Permission, Wish
from ursnav_torch.autonomy.settings import ASSIST, EXPLORE, AutonomySettings
from ursnav_torch.autonomy.states import MOVING, TRANSITIONS, State, StateMachine
from ursnav_torch.autonomy.visits import Explored, Visit

__all__ = [
    "ASSIST",
    "EXPLORE",
    "MOVING",
    "TRANSITIONS",
    "AutonomySettings",
    "Explored",
    "Explorer",
    "Perception",
    "Permission",
    "State",
    "StateMachine",
    "Visit",
    "Wish",
]
