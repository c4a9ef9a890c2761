"""The experiment as one HTML page that needs no other file."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ursnav_torch.registration import Confusion
from ursnav_torch.rendering import Renderer
from ursnav_torch.reports.html import inline_picture, render_page
from ursnav_torch.thesis import pictures as draw
from ursnav_torch.thesis import plots
from ursnav_torch.thesis.figures import Figure, counts, pose_errors, share
from ursnav_torch.thesis.run import Outcome
from ursnav_torch.thesis.series import Matched

#: Thesis Table 5.2, last column, and Eq. 6.1.
_PRINTED_E_CAM = (12.62, 14.09, 13.64, 14.50, 13.67)
_PRINTED_CONFUSION = Confusion(14, 1, 2, 7)
_PLOTS = {
    "points": plots.plot_points,
    "seconds": plots.plot_seconds,
    "time_against_points": plots.plot_time_against_points,
    "distances": plots.plot_distances,
    "directions": plots.plot_directions,
}


def report_page(o: Outcome, figures: Sequence[Figure], name: str, renderer: Renderer) -> str:
    """The page.

    Args:
        o: what came out.
        figures: printed and ours.
        name: of the experiment.
        renderer: draws the kidney for the pictures.
    """
    return render_page(
        "report.html.j2",
        room="ursnav_torch.thesis",
        title=f"The thesis's experiment in simulation: {name}",
        scale=f"{o.vid.kidney.scale:g}",
        views=len(o.vid),
        figures=figures,
        visited=", ".join(dict.fromkeys(o.drive.visited)) or "none",
        drive_s=f"{o.drive.t_s[-1]:.0f}",
        drive=inline_picture(draw.jpeg(draw.drive_overview(o))),
        landmarks=_landmarks(o),
        suspicions=o.registration.suspicions,
        registration=inline_picture(plots.plot_registration(o)),
        threshold=_threshold(o),
        reference=inline_picture(draw.jpeg(draw.reference_pairs(o, renderer))),
        reference_names=", ".join(_name(o.phantom, i) for i in o.reference),
        series=[_series(o, o.simulation, renderer), _series(o, o.phantom, renderer)],
        plots={kind: inline_picture(plot(o)) for kind, plot in _PLOTS.items()},
        verdicts=_verdicts(o),
        **_places(o),
    )


def _landmarks(o: Outcome) -> list[list[str]]:
    """Rows of number, kidney's and EM's coordinates, residual."""
    pairs = zip(o.landmarks_kidney, o.landmarks_em, o.registration.fre_mm, strict=True)
    return [
        [f"{i + 1}", *(f"{v:.1f}" for v in (*kidney, *em)), f"{residual:.2f}"]
        for i, (kidney, em, residual) in enumerate(pairs)
    ]


def _threshold(o: Outcome) -> list[tuple[str, str, str]]:
    """Rows of a picture's name, the thesis's e_cam and ours, and how the threshold comes of them."""
    v = o.verdicts
    names = [_name(o.phantom, i) for i in o.reference]
    printed = [f"{x:.2f}" for x in _PRINTED_E_CAM] + [""] * len(names)
    return [
        *((name, p, f"{e:.2f}") for name, p, e in zip(names, printed, v.e_cam_mm, strict=False)),
        ("mean", "13.70", f"{v.e_cam_mm.mean():.2f}"),
        ("deviation", "0.70", f"{v.e_cam_mm.std(ddof=1):.2f}"),
        ("threshold", "15.10", f"{v.threshold_mm:.2f}"),
    ]


def _series(o: Outcome, series: Matched, renderer: Renderer) -> dict[str, Any]:
    """One kind of pictures: how many are right, and a strip of each."""
    phantom = series is o.phantom
    strips = [
        {"src": inline_picture(draw.jpeg(draw.strip(o, series, i, renderer), 80))} | _caption(o, series, i)
        for i in range(len(series.rows))
    ]
    return {
        "title": "Phantom" if phantom else "Simulation",
        "where": "Fig. 5.11 to 5.23" if phantom else "Fig. 5.3 to 5.10",
        "share": share(series),
        "refused": sum(1 for row in series.rows if row.get("error")),
        "poses": inline_picture(draw.jpeg(draw.poses_overview(o, series))),
        "strips": strips,
    }


def _caption(o: Outcome, series: Matched, i: int) -> dict[str, Any]:
    """What is said of a picture."""
    row, name = series.rows[i], _name(series, i)
    if row.get("error"):
        return {"name": name, "error": str(row["error"])}
    position, direction = pose_errors(series)
    words = (
        f"off by {position[i]:.1f} mm, {np.degrees(direction[i]):.0f}°; {row['points']} points, {row['seconds']:.3f} s"
    )
    if series is o.phantom and o.verdicts.judged[i]:
        by_position, both = o.verdicts.right_by_position[i], o.verdicts.right[i]
        words += f"; the sensor says {_word(by_position)} by position, {_word(both)} by position and direction"
    calyx = row["calyx"] or "no calyx"
    return {"name": name, "error": "", "calyx": calyx, "right": bool(series.right[i]), "words": words}


def _verdicts(o: Outcome) -> dict[str, list[str]]:
    """Counts TP, FN, FP, TN of each rule."""
    found = o.verdicts.confusions()
    rules = {
        "thesis, by position": _PRINTED_CONFUSION,
        "ours, by position": found["position"],
        "ours, by position and direction": found["position_and_direction"],
    }
    return {name: counts(confusion).split(", ") for name, confusion in rules.items()}


def _places(o: Outcome) -> dict[str, str]:
    """First, middle and last of the pictures that are right, in the kidney; blank where none is."""
    right = np.flatnonzero(o.phantom.right)
    if not len(right):
        return {"places": "", "places_names": ""}
    rows = sorted({int(right[0]), int(right[len(right) // 2]), int(right[-1])})
    drawn = inline_picture(draw.jpeg(draw.places(o, rows)))
    return {"places": drawn, "places_names": ", ".join(_name(o.phantom, i) for i in rows)}


def _name(series: Matched, i: int) -> str:
    return series.pictures.names[i].removesuffix(".png")


def _word(right: bool) -> str:
    return "right" if right else "wrong"
