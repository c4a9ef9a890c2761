"""The experiment as one HTML page that needs no other file."""

import base64
import html
from collections.abc import Sequence

import numpy as np

from ursnav_torch.registration import Confusion
from ursnav_torch.rendering import Renderer
from ursnav_torch.thesis import pictures as draw
from ursnav_torch.thesis import plots
from ursnav_torch.thesis.figures import Figure, counts, pose_errors, share
from ursnav_torch.thesis.run import Outcome
from ursnav_torch.thesis.series import Matched

_STYLE = """
body{font:15px/1.45 system-ui,sans-serif;margin:2em auto;max-width:1040px;padding:0 1em;color:#222}
table{border-collapse:collapse;margin:1em 0}td,th{padding:.2em .7em;border-bottom:1px solid #ddd;text-align:left}
td.n{text-align:right;font-variant-numeric:tabular-nums}figure{margin:1em 0}figcaption{font-size:13px;color:#555}
td:nth-child(-n+3){white-space:nowrap}img{display:block;max-width:100%}.pairs figure{margin:.2em 0}
.no{color:#a33}.yes{color:#17691f}.dim{color:#777}nav a{margin-right:1em}h2{border-top:2px solid #888;padding-top:.6em}
footer{color:#666;border-top:1px solid #ccc;margin-top:2em}
"""
#: Thesis Table 5.2, last column, and Eq. 6.1.
_PRINTED_E_CAM = (12.62, 14.09, 13.64, 14.50, 13.67)
_PRINTED_CONFUSION = Confusion(14, 1, 2, 7)


def report_page(o: Outcome, figures: Sequence[Figure], name: str, renderer: Renderer) -> str:
    """The page.

    Args:
        o: what came out.
        figures: printed and ours.
        name: of the experiment.
        renderer: draws the kidney for the pictures.
    """
    title = f"The thesis's experiment in simulation: {name}"
    series = (_series(o, o.simulation, renderer), _series(o, o.phantom, renderer))
    head = (_summary(o, figures), _world(o), _landmarks(o), _threshold(o, renderer))
    sections = (*head, *series, _speed(o), _verdicts(o), _where(o))
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{html.escape(title)}</title>'
        f"<style>{_STYLE}</style><h1>{html.escape(title)}</h1>{''.join(sections)}"
        "<footer>Research software, not a medical device. Everything here is simulated: the phantom, the robot, the "
        "camera's faults and the EM tracker.</footer></html>"
    )


def _summary(o: Outcome, figures: Sequence[Figure]) -> str:
    scale = o.vid.kidney.scale
    rows = "".join(
        f"<tr><td>{html.escape(f.name)}</td><td>{html.escape(f.printed) or _dim('not printed')}</td>"
        f"<td><b>{html.escape(f.ours) or '-'}</b></td><td>{_dim(f.where)}</td></tr>"
        for f in figures
    )
    return (
        f"<p>A phantom kidney {scale:g} times as large as life is turned into a database of {len(o.vid)} views (VID). "
        "Points of it are touched with an EM sensor, which ties the tracker's frame to the kidney's. A robot then "
        "drives a scope into every calyx and takes pictures; each is matched with the views, which says which calyx it "
        "shows and where the scope is; the EM sensor judges whether that is right. Numbers that the thesis printed "
        f"stand beside ours. <b>All lengths are mm at scale {scale:g}</b> (divide by {scale:g} for anatomy). The "
        "thesis had one printed phantom and a real camera; ours are another kidney and simulated faults, so the two "
        "columns show the same experiment, not the same kidney.</p>"
        f"<table><tr><th>figure</th><th>thesis</th><th>ours</th><th>where in the thesis</th></tr>{rows}</table>"
    )


def _world(o: Outcome) -> str:
    names = ", ".join(dict.fromkeys(o.drive.visited)) or "none"
    return (
        f"<h2>The robot's drive</h2><p>The scope reached the calyces {html.escape(names)} in "
        f"{o.drive.t_s[-1]:.0f} s of simulated time. Calyces are named where their tips are.</p>"
        + _figure(draw.jpeg(draw.drive_overview(o)), "The way of the tip, from two sides.")
    )


def _landmarks(o: Outcome) -> str:
    rows = "".join(
        f"<tr><td class=n>{i + 1}</td>{_cells(a, 1)}{_cells(b, 1)}{_cells([o.registration.fre_mm[i]], 2)}</tr>"
        for i, (a, b) in enumerate(zip(o.landmarks_kidney, o.landmarks_em, strict=True))
    )
    said = "".join(f"<p class=no>{html.escape(sentence)}</p>" for sentence in o.registration.suspicions)
    return (
        "<h2>Registration (Table 5.1, Fig. 5.1)</h2><p>Kidney columns are centers of spheres laid on the model, "
        "half the sensor's length in radius; EM columns are what the tracker read "
        "while the sensor touched the phantom there. mm.</p>"
        "<table><tr><th>no.</th><th colspan=3>kidney x, y, z</th><th colspan=3>EM x, y, z</th><th>residual</th></tr>"
        f"{rows}</table>{said}"
        + _figure(plots.plot_registration(o), "Left: the landmarks. Right: how far each is off after registration.")
    )


def _threshold(o: Outcome, renderer: Renderer) -> str:
    v = o.verdicts
    names = [o.phantom.pictures.names[i].removesuffix(".png") for i in o.reference]
    printed = [f"{x:.2f}" for x in _PRINTED_E_CAM] + [""] * len(names)
    rows = "".join(
        f"<tr><td>{name}</td><td class=n>{p}</td><td class=n>{e:.2f}</td></tr>"
        for name, p, e in zip(names, printed, v.e_cam_mm, strict=False)
    )
    return (
        "<h2>Threshold of the EM sensor (Table 5.2, Fig. 5.2)</h2><p>For some pictures a hand looked up the same view "
        "in the model. The distance of that view from the sensor is e_cam; the threshold is its mean plus its "
        "deviation plus the sensor's own error of 0.7 mm (Eq. 4.3, 4.4). The thesis's e_cam is larger because "
        "its virtual and its real camera had different fields of view.</p>"
        f"<table><tr><th>picture</th><th>thesis's A to E</th><th>ours</th></tr>{rows}"
        f"<tr><td>mean</td><td class=n>13.70</td><td class=n>{v.e_cam_mm.mean():.2f}</td></tr>"
        f"<tr><td>deviation</td><td class=n>0.70</td><td class=n>{v.e_cam_mm.std(ddof=1):.2f}</td></tr>"
        f"<tr><td>threshold</td><td class=n>15.10</td><td class=n>{v.threshold_mm:.2f}</td></tr></table>"
        + _figure(
            draw.jpeg(draw.reference_pairs(o, renderer)), f"Above: pictures {', '.join(names)}. Below: their views."
        )
    )


def _series(o: Outcome, series: Matched, renderer: Renderer) -> str:
    phantom = series is o.phantom
    where = "Fig. 5.11 to 5.23" if phantom else "Fig. 5.3 to 5.10"
    strips = "".join(
        _figure(draw.jpeg(draw.strip(o, series, i, renderer), 80), _caption(o, series, i))
        for i in range(len(series.rows))
    )
    poses = _figure(
        draw.jpeg(draw.poses_overview(o, series)), "Green: where a picture was taken; orange: where it was placed."
    )
    return (
        f"<h2>{'Phantom' if phantom else 'Simulation'} pictures ({where})</h2><p>Matched with the right calyx: "
        f"<b>{share(series)}</b>. From left to right: the picture, its edges (green), the matched view with its edges "
        "(orange; perhaps turned, where pictures are compared at every roll), the kidney drawn from the place found, "
        "and from where the picture was truly taken. The fourth should look like the last.</p>"
        f"{_refusals(series)}{poses}<div class=pairs>{strips}</div>"
    )


def _refusals(series: Matched) -> str:
    refused = sum(1 for row in series.rows if row.get("error"))
    if not refused:
        return ""
    return (
        f"<p class=no>{refused} of {len(series.rows)} pictures were not matched at all: too few of their edges pass "
        "the thresholds of features= for a shape to be compared.</p>"
    )


def _caption(o: Outcome, series: Matched, i: int) -> str:
    row, name = series.rows[i], series.pictures.names[i].removesuffix(".png")
    if row.get("error"):
        return f"<b>{name}</b>: <span class=no>not matched.</span> {html.escape(str(row['error']))}"
    verdict = "right" if series.right[i] else "wrong"
    position, direction = pose_errors(series)
    text = (
        f"<b>{name}</b>: taken for {html.escape(row['calyx']) or 'no calyx'}, "
        f"<span class={'yes' if series.right[i] else 'no'}>{verdict}</span>; off by {position[i]:.1f} mm, "
        f"{np.degrees(direction[i]):.0f}°; {row['points']} points, {row['seconds']:.3f} s"
    )
    if series is o.phantom and o.verdicts.judged[i]:
        by_position, both = o.verdicts.right_by_position[i], o.verdicts.right[i]
        text += f"; the sensor says {_word(by_position)} by position, {_word(both)} by position and direction"
    return text


def _speed(o: Outcome) -> str:
    return (
        "<h2>Points and time (Fig. 5.15, 5.24, 5.25)</h2><p>Phantom pictures; time is from the picture to its place, "
        "edges included. The thesis prints these as bars without numbers, and R² = 0.98.</p>"
        + _figure(plots.plot_points(o), "Edge points of each picture.")
        + _figure(plots.plot_seconds(o), "Seconds for each picture.")
        + _figure(plots.plot_time_against_points(o), "Seconds against points.")
    )


def _verdicts(o: Outcome) -> str:
    found = o.verdicts.confusions()
    rules = {
        "thesis, by position": _PRINTED_CONFUSION,
        "ours, by position": found["position"],
        "ours, by position and direction": found["position_and_direction"],
    }
    rows = "".join(
        f"<tr><td>{name}</td>{''.join(f'<td class=n>{n}</td>' for n in counts(c).split(', '))}</tr>"
        for name, c in rules.items()
    )
    return (
        "<h2>The EM sensor's verdict (Fig. 5.26, Eq. 6.1)</h2><p>By the thesis's rule a match is right when the sensor "
        "is nearer than the threshold to the matched view. A view of another calyx from the same place passes for "
        "right; the sensor's axis, which a 5-DoF sensor knows too, exposes it. Pictures that could not be matched have "
        "no verdict.</p><table><tr><th>verdict</th><th>right, called right (TP)</th><th>right, called wrong (FN)</th>"
        f"<th>wrong, called right (FP)</th><th>wrong, called wrong (TN)</th></tr>{rows}</table>"
        + _figure(plots.plot_distances(o), "Distance between the sensor and the matched view.")
        + _figure(plots.plot_directions(o), "Angle between the sensor's axis and the matched view's optical axis.")
    )


def _where(o: Outcome) -> str:
    right = np.flatnonzero(o.phantom.right)
    if not len(right):
        return ""
    rows = sorted({int(right[0]), int(right[len(right) // 2]), int(right[-1])})
    names = ", ".join(o.phantom.pictures.names[i].removesuffix(".png") for i in rows)
    return "<h2>Where the scope is (Fig. 5.27)</h2>" + _figure(
        draw.jpeg(draw.places(o, rows)), f"Pictures {names}: place, axes and field of view as they were found."
    )


def _figure(picture: bytes, caption: str) -> str:
    kind = "png" if picture.startswith(b"\x89PNG") else "jpeg"
    data = base64.b64encode(picture).decode()
    plain = html.escape(caption.replace("<b>", "").replace("</b>", "").split("<")[0], quote=True)
    return (
        f'<figure><img src="data:image/{kind};base64,{data}" alt="{plain}"><figcaption>{caption}</figcaption></figure>'
    )


def _cells(values: Sequence[float] | np.ndarray, digits: int) -> str:
    return "".join(f"<td class=n>{v:.{digits}f}</td>" for v in values)


def _dim(text: str) -> str:
    return f"<span class=dim>{html.escape(text)}</span>"


def _word(right: bool) -> str:
    return "right" if right else "wrong"
