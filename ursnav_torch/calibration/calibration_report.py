"""What is kept and shown of a calibration."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ursnav_torch.calibration.solve import Calibration
from ursnav_torch.files import write_json
from ursnav_torch.results import whole_set


def save_calibration(result: Calibration, path: Path, overwrite: bool = False) -> None:
    """Write the camera JSON (with ``rms_px``, ``images`` and ``seen_deg`` beside the lens) and, beside it, a PNG of
    where the corners lay and how far the lens misses them.

    Raises:
        InputError: one of the two exists and ``overwrite`` is false.
    """
    picture = path.with_suffix(".png")
    quality = {"rms_px": round(result.rms_px, 4), "images": len(result.corners), "seen_deg": round(result.seen_deg, 1)}
    data = result.camera.to_dict() | quality
    with whole_set((path, picture), overwrite, data) as both:
        if both.outcome is None:
            _residual_plot(result).savefig(both.staged(picture), format="png", dpi=120)
            write_json(both.staged(path), data)
            both.outcome = True


def summary(result: Calibration) -> str:
    """What a user should know of a calibration, in a few lines."""
    camera, n = result.camera, len(result.corners)
    fov = "the whole picture is lit" if camera.fov_deg is None else f"{camera.fov_deg:.0f} degrees"
    lines = [
        f"{n} of {n + len(result.left_out)} pictures used, reprojection error {result.rms_px:.2f} px (RMS)",
        f"fx {camera.fx:.1f}  fy {camera.fy:.1f}  cx {camera.cx:.1f}  cy {camera.cy:.1f}  field of view: {fov}",
        f"corners were seen up to {result.seen_deg:.0f} degrees from the axis; farther out the lens is extrapolated",
    ]
    for why in dict.fromkeys(result.left_out.values()):
        names = [name for name, reason in result.left_out.items() if reason == why]
        lines.append(f"left out, {why}: {', '.join(names)}")
    return "\n".join(lines)


def _residual_plot(result: Calibration) -> Figure:
    camera = result.camera
    pixels = np.concatenate([corners.pixels for corners in result.corners.values()])
    off = np.linalg.norm(result.residuals_px, axis=1)
    figure = Figure(figsize=(11, 5), layout="constrained")
    place, spread = figure.subplots(1, 2)
    arrows = place.quiver(*pixels.T, *result.residuals_px.T, off, angles="xy", scale_units="xy", scale=0.05)
    figure.colorbar(arrows, ax=place, label="px")
    place.set(title="corners and residuals, 20 times enlarged", aspect="equal")
    place.set(xlim=(-0.5, camera.width - 0.5), ylim=(camera.height - 0.5, -0.5), xlabel="px", ylabel="px")
    names = list(result.rms_by_image)
    spread.barh(names, [result.rms_by_image[name] for name in names])
    spread.axvline(result.rms_px, color="black", linewidth=1)
    spread.set(title=f"reprojection error, {result.rms_px:.2f} px over all", xlabel="RMS, px")
    spread.tick_params(axis="y", labelsize=7)
    return figure
