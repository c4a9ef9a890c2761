"""VIDs of phantoms, each built once in a folder and then kept there."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from ursnav_torch.camera import equidistant_camera
from ursnav_torch.features import DefaultSettings, Settings
from ursnav_torch.kidney import Kidney
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.vid import PlanSettings, Vid, build_vid, load_vid


def phantom_vid(
    kidney: Kidney,
    plan: PlanSettings,
    out: Path,
    learn: Callable[[Vid], dict[str, object]] | None = None,
    workers: int | None = 1,
    settings: Settings | None = None,
) -> Vid:
    """The VID of a kidney through a fisheye of 160 degrees and 250 px, from a folder where it lies there already.

    Args:
        kidney: the phantom.
        plan: its views.
        out: the VID's folder.
        learn: what is learned when it is built, see `build_vid`; nothing when None.
        workers: processes that draw it; all cores when None.
        settings: of the features, the default's when None.
    """
    if (out / "vid.json").exists():
        return load_vid(out)
    out.parent.mkdir(parents=True, exist_ok=True)
    more: dict[str, Any] = {} if learn is None else {"learn": learn}
    features = settings or DefaultSettings()
    return build_vid(kidney, equidistant_camera(), features, RaycastRenderer, plan, out, workers=workers, **more)
