"""EM logs: read with their units, clocks and words for "not visible", and joined with pictures."""

from ursnav_torch.em_log.clock import check_clock, check_pace
from ursnav_torch.em_log.join import EmJoin, join_names, join_pictures
from ursnav_torch.em_log.read import read_em_samples
from ursnav_torch.em_log.samples import EmFormat, EmSamples

__all__ = [
    "EmFormat",
    "EmJoin",
    "EmSamples",
    "check_clock",
    "check_pace",
    "join_names",
    "join_pictures",
    "read_em_samples",
]
