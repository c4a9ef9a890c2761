"""How stones are told from their pictures."""

from dataclasses import dataclass

from ursnav_torch.errors import InputError

#: What is left above this is a residual fragment (EAU guideline on urolithiasis, 2024), mm at scale 1.
RESIDUAL_MM = 2.0


@dataclass(frozen=True, slots=True)
class StoneMapSettings:
    """How sightings become stones; mm at the kidney's scale 1. Those of evidence and size were chosen by
    ``python -m benchmarks.stones half=choosing vary=NAME=VALUE,...``.

    Attributes:
        farthest_mm: a sighting farther than this is none.
        bearing_deg: standard deviation of a sighting's middle, from the network's cells of 4 px.
        angle_share: standard deviation of a sighting's apparent radius, as a share of it.
        contact_mm, contact_share: standard deviation of the gap between stone and wall: fixed, and per mm of radius.
        alike: so many pictures of a stone say as much as one, as their faults are alike.
        alike_mm: of pictures from within this of each other the one tells place and size that shows most of the stone;
            0.5 and 1 find 27 of the 27 choosing stones that were shown, and 0 finds 26 (``vary=alike_mm=0,0.5,1``).
        gate: a sighting is of a stone where it lies within this share of their apparent radii.
        independent_s: pictures count whole from this long after the one before.
        hit: share of a sighting's log odds that counts, as pictures of one place err alike.
        miss: log odds that a picture takes that does not show a stone where one is expected.
        expected_share: a stone counts as missed where it would cover this share of the picture.
        least: log odds from which on a stone is told.
        certain: log odds that a stone had once, which is told although it is gone.
        most: log odds are kept below; so much must be taken before a stone is gone.
        gone: log odds below which a stone that was told is gone.
        size_quantile: of the extents seen, the one taken for the longest diameter.
        size_factor: true by seen extent, chosen by ``python -m benchmarks.stones half=choosing kidneys=20
            vary=size_factor=1.1,1.15,1.2``.
        smallest_mm: what is smaller is no stone but a fragment: it is counted, not listed. One that may be as large, by
            a standard deviation, and was seen from two places that are not alike is listed.
        speck_mm: what is smaller is not even that.
    """

    farthest_mm: float = 25.0
    bearing_deg: float = 1.5
    angle_share: float = 0.15
    contact_mm: float = 0.3
    contact_share: float = 0.15
    alike: float = 4.0
    alike_mm: float = 0.5
    gate: float = 0.8
    independent_s: float = 0.25
    hit: float = 1.0
    miss: float = 1.0
    expected_share: float = 0.03
    least: float = 4.5
    certain: float = 9.0
    most: float = 12.0
    gone: float = -2.0
    size_quantile: float = 0.5
    size_factor: float = 1.15
    smallest_mm: float = RESIDUAL_MM
    speck_mm: float = 1.2

    def __post_init__(self) -> None:
        if min(self.hit, self.miss, self.independent_s, self.alike, self.size_factor) <= 0:
            raise InputError(f"hit, miss, independent_s, alike and size_factor must be above 0, got {self}.")
        if not self.gone < self.least <= self.most or not 0 <= self.size_quantile <= 1:
            raise InputError(
                f"Stones need gone < least <= most and size_quantile in 0..1, got gone={self.gone}, "
                f"least={self.least}, most={self.most}, size_quantile={self.size_quantile}."
            )
