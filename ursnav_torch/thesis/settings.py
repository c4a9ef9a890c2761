"""How the experiment is done, apart from the pipeline that it tests."""

from dataclasses import dataclass, field

from ursnav_torch.devices import Limits
from ursnav_torch.errors import InputError
from ursnav_torch.registration import ErrorBudget
from ursnav_torch.simulation import EmField, Scope


@dataclass(frozen=True, slots=True)
class ProtocolSettings:
    """The thesis's protocol (chapters 4 and 5); what it does not print is marked *ours*.

    Attributes:
        pictures_per_calyx: simulation pictures, and phantom pictures, of each calyx.
        nearest_mm, farthest_mm: a picture of a calyx is taken this far from its tip, mm at scale 1 (*ours*).
        aim_deg: the operator takes it when the tip lies within this angle of the optical axis (*ours*).
        tilt_deg: spread of the simulation pictures' direction about the way in (*ours*).
        landmarks: points touched on the phantom.
        reach_mm: half the sensor's length, by which its reported center stands off what it touches (§4.4).
        hold_deg: how far off the wall's normal the hand holds the sensor (*ours*).
        pick_mm: root mean square error of finding a touched point on the model (*ours*).
        references: phantom pictures whose view is looked up by hand in the model, for e_cam (§4.5).
        reference_mm, reference_deg: how well a hand finds such a view (*ours*).
        budget: root mean square errors that the verdict by position and direction allows for.
        least_p: a match with a smaller p-value is judged wrong.
        views_by_hand: whether the views are held at the scope's own roll, as a hand collects them; else upright.
        em: the EM tracker's world. scope: the scope. limits: of its joints.
        seed: of everything drawn at random.
    """

    pictures_per_calyx: int = 3
    nearest_mm: float = 5.0
    farthest_mm: float = 11.0
    aim_deg: float = 30.0
    tilt_deg: float = 8.0
    landmarks: int = 8
    reach_mm: float = 4.0
    hold_deg: float = 5.0
    pick_mm: float = 1.0
    references: int = 5
    reference_mm: float = 1.5
    reference_deg: float = 3.0
    budget: ErrorBudget = field(default_factory=ErrorBudget)
    least_p: float = 0.01
    views_by_hand: bool = False
    em: EmField = field(default_factory=EmField)
    scope: Scope = field(default_factory=Scope)
    limits: Limits = field(default_factory=Limits)
    seed: int = 0

    def __post_init__(self) -> None:
        if self.pictures_per_calyx < 1 or self.landmarks < 4 or self.references < 2:
            raise InputError(
                "The experiment needs pictures_per_calyx >= 1, landmarks >= 4 and references >= 2; got "
                f"{self.pictures_per_calyx}, {self.landmarks} and {self.references}."
            )
        if min(self.reach_mm, self.hold_deg, self.pick_mm, self.reference_mm, self.reference_deg) < 0:
            raise InputError("reach_mm, hold_deg, pick_mm, reference_mm and reference_deg must not be negative.")
        if not 0 < self.nearest_mm < self.farthest_mm:
            raise InputError(f"Expected 0 < nearest_mm < farthest_mm, got {self.nearest_mm} and {self.farthest_mm}.")
