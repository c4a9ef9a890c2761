"""How an exploration is judged and guided."""

from dataclasses import dataclass, field

from ursnav_torch.exploration.coverage import CoverageSettings
from ursnav_torch.exploration.route import ScopeLimits
from ursnav_torch.stones import StoneMapSettings


@dataclass(frozen=True, slots=True)
class ExplorationSettings:
    """When wall counts as seen, what the scope can do, and how stones are told, see each part."""

    coverage: CoverageSettings = field(default_factory=CoverageSettings)
    limits: ScopeLimits = field(default_factory=ScopeLimits)
    stones: StoneMapSettings = field(default_factory=StoneMapSettings)
