"""What was learned about certainty, stored: with the package from a population of phantoms, with a VID from its own."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ursnav_torch.errors import InputError
from ursnav_torch.localization.calibrating import kidneys_own, learn_certainty
from ursnav_torch.localization.certainty import CertaintyModel
from ursnav_torch.localization.evidence import (
    CALYX_NUMBERS,
    NUMBERS,
    REFINED_CALYX_NUMBERS,
    REFINED_NUMBERS,
    Evidence,
)
from ursnav_torch.localization.fitting import Asked
from ursnav_torch.records import read_json, to_record

#: Learned over a population of phantoms by ``python -m benchmarks.certainty``.
PACKAGED = Path(__file__).with_name("certainty.json")
_DIGITS = 4
#: Fewer right or wrong answers than this are nothing to learn from.
_LEAST = 5


@dataclass(frozen=True, slots=True)
class PositionErrors:
    """How far off a track's positions are.

    Attributes:
        weights: constant, and weights of the alignment's score and of the logarithm of the hypotheses' spread, in the
            logarithm of what two of three errors are within, mm at scale 1: one standard deviation.
        region_sd: standard deviations within which nine of ten are; errors have other tails than a Gaussian's.
    """

    weights: tuple[float, float, float]
    region_sd: float


@dataclass(frozen=True, slots=True)
class TrackWeights:
    """How a track's evidence is read, see `tracking.certainty`.

    Attributes:
        least_share: for every one of `LEVELS`, of the hypotheses' probability, from which on a calyx may be the one.
        position, position_told: without a robot's word, and with it.
        direction: as `PositionErrors.weights`, of degrees.
    """

    least_share: tuple[float, ...]
    position: PositionErrors
    position_told: PositionErrors
    direction: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Packaged:
    """`CertaintyModel`s of answers with and without refinement, and the settings that they hold for; and tracks'."""

    settings: str
    refined: CertaintyModel
    nearest: CertaintyModel
    track: TrackWeights | None = None


def certainty_model(calibration: Mapping[str, object] | None, settings: str, refined: bool) -> CertaintyModel | None:
    """The model for one VID; None where nothing was learned with the settings at hand.

    With the package's own settings it is the population's, its log-odds shifted as the VID's own pictures ask for; with
    others it is fitted to the VID's own pictures alone.

    Args:
        calibration: of the VID.
        settings: as `Localizer.evidence_settings` says them.
        refined: whether answers are refined.
    """
    own = own_pictures(calibration, settings, refined)
    packaged = packaged_models()
    if packaged is not None and packaged.settings == settings:
        model = packaged.refined if refined else packaged.nearest
        return model if own is None else kidneys_own(model, own)
    if own is None or min(own.right.sum(), (~own.right).sum()) < _LEAST:
        return None
    return learn_certainty(own)


@lru_cache(maxsize=1)
def packaged_models() -> Packaged | None:
    """What the package learned; None in a tree that has not learned yet."""
    if not PACKAGED.exists():
        return None
    return to_record(read_json(PACKAGED, "certainty"), Packaged, str(PACKAGED))


def save_packaged(models: Packaged, path: Path = PACKAGED) -> None:
    """Store models as the package's."""
    path.write_text(json.dumps(asdict(models)) + "\n", encoding="utf-8")
    packaged_models.cache_clear()


def evidence_table(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Plain data of pictures that were asked, for `own_pictures`: each with ``shown``, and of both ways of answering
    (``refined``, ``nearest``) the `Evidence` and errors ``mm`` and ``deg``, None for a picture of nothing."""
    return [{"shown": int(row["shown"])} | {how: _plain(*row[how]) for how in ("refined", "nearest")} for row in rows]


def own_pictures(calibration: Mapping[str, object] | None, settings: str, refined: bool) -> Asked | None:
    """The pictures that a VID was asked when it was built; None where it was asked with other settings, or not at all.

    Raises:
        InputError: what is stored is no such table.
    """
    learned = (calibration or {}).get("confidence")
    if not isinstance(learned, Mapping) or learned.get("settings") != settings or "pictures" not in learned:
        return None
    return asked_from_table(learned["pictures"], refined)


def asked_from_table(rows: Any, refined: bool) -> Asked:
    """The inverse of `evidence_table`, for one way of answering.

    Raises:
        InputError: rows that are none.
    """
    how = "refined" if refined else "nearest"
    numbers = len(NUMBERS) - (0 if refined else REFINED_NUMBERS)
    kinds = len(CALYX_NUMBERS) - (0 if refined else REFINED_CALYX_NUMBERS)
    try:
        own = [row[how] for row in rows]
        found = [Evidence(int(r["answer"]), np.array(r["numbers"], float), np.array(r["calyces"], float)) for r in own]
        if any(e.numbers.shape != (numbers,) or e.calyces.shape[1:] != (kinds,) for e in found):
            raise ValueError(f"its pictures have not {numbers} and {kinds} numbers each")
        errors = [[np.nan if r[key] is None else float(r[key]) for r in own] for key in ("mm", "deg")]
        shown = np.array([int(row["shown"]) for row in rows], np.int64)
        kidney = np.array([int(row.get("kidney", 0)) for row in rows], np.int64)
        kind = np.array([str(row.get("kind", "")) for row in rows])
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise InputError(f"The evidence of simulated pictures cannot be used ({error}); build the VID again.") from None
    return Asked(found, shown, np.array(errors[0]), np.array(errors[1]), kidney, kind)


def _plain(evidence: Evidence, mm: float | None, deg: float | None) -> dict[str, Any]:
    numbers, calyces = (np.asarray(v, float).round(_DIGITS).tolist() for v in (evidence.numbers, evidence.calyces))
    errors = [None if v is None else round(float(v), _DIGITS) for v in (mm, deg)]
    return {"answer": evidence.answer, "numbers": numbers, "calyces": calyces, "mm": errors[0], "deg": errors[1]}
