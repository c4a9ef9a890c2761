"""What is kept and shown of a calibration."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ursnav_torch.calibration.solve import UNCERTAIN_FOCAL, Calibration
from ursnav_torch.files import write_image, write_json
from ursnav_torch.results import whole_set


def save_calibration(result: Calibration, path: Path, overwrite: bool = False) -> None:
    """Write the camera JSON (with ``rms_px``, ``images``, ``seen_deg`` and ``covered`` beside the lens).

    Beside it go a PNG of where the corners lay and how far the lens misses them, and one of the picture's mask where it
    has one.

    Raises:
        InputError: one of them exists and ``overwrite`` is false.
    """
    paths = calibration_files(path)
    mask = result.camera.mask_image()
    quality = {"rms_px": round(result.rms_px, 4), "images": len(result.corners), "seen_deg": round(result.seen_deg, 1)}
    quality |= {"focal_sd_px": round(result.focal_sd_px, 2)}
    data = result.camera.to_dict() | quality | {"covered": round(result.field.share, 3)}
    if mask is not None:
        data["mask"] = paths[2].name
    with whole_set(paths if mask is not None else paths[:2], overwrite, data) as whole:
        if whole.outcome is None:
            _residual_plot(result).savefig(whole.staged(paths[1]), format="png", dpi=120)
            if mask is not None:
                write_image(whole.staged(paths[2]), np.where(mask, 255, 0).astype(np.uint8))
            write_json(whole.staged(path), data)
            whole.outcome = True


def calibration_files(path: Path) -> tuple[Path, Path, Path]:
    """The camera JSON, the picture of its residuals, and the mask, which is not always there."""
    return path, path.with_suffix(".png"), path.with_suffix(".mask.png")


def summary(result: Calibration) -> str:
    """What a user should know of a calibration, in a few lines."""
    camera, n = result.camera, len(result.corners)
    fov = "the whole picture is lit" if camera.fov_deg is None else f"{camera.fov_deg:.0f} degrees"
    lines = [
        f"{n} of {n + len(result.left_out)} pictures used, reprojection error {result.rms_px:.2f} px (RMS)",
        f"fx {camera.fx:.1f}  fy {camera.fy:.1f}  cx {camera.cx:.1f}  cy {camera.cy:.1f}  field of view: {fov}",
        f"corners were seen up to {result.seen_deg:.0f} degrees from the axis; farther out the lens is extrapolated",
    ]
    if result.focal_sd_px > UNCERTAIN_FOCAL * camera.fx:
        share = result.focal_sd_px / camera.fx
        lines.append(
            f"the focal length is uncertain by {result.focal_sd_px:.0f} px ({share:.0%}): take pictures with "
            "the board tilted by 20 to 40 degrees in different directions"
        )
    lines.append(f"the board's corners came to {result.field.share:.0%} of the picture's parts")
    if result.field.empty:
        lines.append(f"take more pictures with the board at {_listed(result.field.empty)}")
    if camera.mask is not None:
        lines.append("the picture does not fill the frame: its mask is written beside the lens and belongs to it")
    for why in dict.fromkeys(result.left_out.values()):
        names = [name for name, reason in result.left_out.items() if reason == why]
        lines.append(f"left out, {why}: {', '.join(names)}")
    return "\n".join(lines)


def _listed(names: tuple[str, ...]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _residual_plot(result: Calibration) -> Figure:
    camera = result.camera
    pixels = np.concatenate([corners.pixels for corners in result.corners.values()])
    off = np.linalg.norm(result.residuals_px, axis=1)
    figure = Figure(figsize=(11, 5), layout="constrained")
    place, spread = figure.subplots(1, 2)
    shade = np.where(result.field.part < 0, 0.75, np.where(np.isin(result.field.part, result.field.without), 0.4, 0.0))
    place.imshow(shade, cmap="Greys", vmin=0, vmax=1)  # gray parts have no corner, dark is outside the picture
    arrows = place.quiver(*pixels.T, *result.residuals_px.T, off, angles="xy", scale_units="xy", scale=0.05)
    figure.colorbar(arrows, ax=place, label="px")
    place.set(title="corners and residuals, 20 times enlarged; gray: no corner", aspect="equal")
    place.set(xlim=(-0.5, camera.width - 0.5), ylim=(camera.height - 0.5, -0.5), xlabel="px", ylabel="px")
    names = list(result.rms_by_image)
    spread.barh(names, [result.rms_by_image[name] for name in names])
    spread.axvline(result.rms_px, color="black", linewidth=1)
    spread.set(title=f"reprojection error, {result.rms_px:.2f} px over all", xlabel="RMS, px")
    spread.tick_params(axis="y", labelsize=7)
    return figure
