"""The thesis's whole experiment in simulation: collect views, touch landmarks, drive, match, judge, report."""

from ursnav_torch.protocol.experiment import run_experiment
from ursnav_torch.protocol.figures import Figure, beside_text, compare_figures
from ursnav_torch.protocol.run import Outcome, Pipeline, perform
from ursnav_torch.protocol.settings import ProtocolSettings

__all__ = [
    "Figure",
    "Outcome",
    "Pipeline",
    "ProtocolSettings",
    "beside_text",
    "compare_figures",
    "perform",
    "run_experiment",
]
