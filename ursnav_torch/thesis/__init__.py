"""The thesis's whole experiment in simulation: collect views, touch landmarks, drive, match, judge, report."""

from ursnav_torch.thesis.experiment import run_experiment
from ursnav_torch.thesis.figures import Figure, beside_text, compare_figures
from ursnav_torch.thesis.run import Outcome, Pipeline, perform
from ursnav_torch.thesis.settings import ProtocolSettings

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
