"""The page's texts and pictures as plain HTML, made from values that are escaped."""

import base64
import html
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from ursnav_torch.exploration.coverage import CalyxCoverage
from ursnav_torch.localization import LookAlikes
from ursnav_torch.navigation import WORDS, NavigationState, confidence_words
from ursnav_torch.page.scene import VERDICTS


def status_html(status: str) -> str:
    """The status line, large; it has room for eight lines, so that no button below moves while it changes."""
    return (
        '<div class="ursnav-status" role="status" style="font-size:1.15em;font-weight:600;line-height:1.3;'
        f'min-height:11.4em;padding:.5em .8em">{html.escape(status)}</div>'
    )


def confidence_html(state: NavigationState) -> str:
    """The confidence in words and as a bar."""
    if state.T_kidney_camera is None:
        return '<div class="ursnav-confidence" style="min-height:2em;padding:0 .8em">no place known</div>'
    share = max(0.0, min(1.0, state.confidence))
    color = _css(VERDICTS["inspected" if share >= 0.9 else "glimpsed" if share >= 0.6 else "unseen"])
    return (
        f'<div class="ursnav-confidence" style="min-height:2em;padding:0 .8em">{confidence_words(share)} ({share:.0%})'
        f'<div style="height:6px;background:#ddd;border-radius:3px"><div style="height:6px;border-radius:3px;'
        f'width:{share:.0%};background:{color}"></div></div></div>'
    )


def robot_html(state: NavigationState) -> str:
    """How the robot stands, and the last thing that went wrong."""
    notice = f'<div style="color:#a33">{html.escape(state.notice)}</div>' if state.notice else ""
    stands = state.robot or "not heard of yet"
    return f'<div class="ursnav-robot" style="min-height:3.2em;padding:0 .8em">robot: {stands}{notice}</div>'


def picture_html(picture: NDArray[np.uint8], caption: str, kind: str) -> str:
    """A picture (H, W, 3) red, green, blue, within the text itself: nothing is fetched for it."""
    data = base64.b64encode(cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes())
    text, (height, width) = html.escape(caption, quote=True), picture.shape[:2]
    return (
        f'<figure class="ursnav-{kind}" style="margin:0 .8em"><figcaption style="font-size:.85em;color:#555">{text}'
        f'</figcaption><img alt="{text}" style="width:100%;aspect-ratio:{width}/{height}" '
        f'src="data:image/jpeg;base64,{data.decode()}"></figure>'
    )


def coverage_html(coverage: Sequence[CalyxCoverage], chosen: str) -> str:
    """One line a calyx: how much of its wall was seen."""
    rows = "".join(
        f'<tr{" style=background:#e8f0fe" if c.calyx == chosen else ""}><td style="color:{_css(VERDICTS[c.verdict])}">'
        f"&#9679; <b>{html.escape(c.calyx)}</b></td><td>{html.escape(c.pole)}</td><td>{c.verdict}</td>"
        f'<td style="text-align:right">{c.share:.0%}</td></tr>'
        for c in coverage
    )
    return f'<table class="ursnav-coverage" style="width:100%;padding:0 .8em;font-size:.9em">{rows}</table>'


def look_alikes_html(known: LookAlikes | None, names: Sequence[str]) -> str:
    """The matrix of calyces that look alike: rows what is shown, columns what it was taken for, % of the row."""
    if known is None:
        return '<div style="padding:0 .8em">Not known: build_vid learns it from simulated pictures.</div>'
    labels = [html.escape(name) for name in (*names, "(none)")]
    share = 100 * known.counts / np.maximum(known.counts.sum(axis=1, keepdims=True), 1)
    head = "<tr><td></td>" + "".join(f"<th>{label}</th>" for label in labels) + "</tr>"
    rows = "".join(
        f"<tr><th>{label}</th>{''.join(map(_share_cell, row))}</tr>" for label, row in zip(labels, share, strict=True)
    )
    said = "".join(f"<p>{html.escape(text)}</p>" for text in known.sentences(names))
    return f'<div class="ursnav-alike" style="padding:0 .8em;font-size:.85em"><table>{head}{rows}</table>{said}</div>'


def latency_html(state: NavigationState, rate: float) -> str:
    """Where the time goes, and what is left out for it."""
    t = state.latency
    parts = {"waiting": t.waiting_s, "features": t.features_s, "tracking": t.tracking_s, "painting": t.painting_s}
    stages = ", ".join(f"{name} {1e3 * seconds:.0f}" for name, seconds in parts.items())
    return (
        f'<div class="ursnav-latency" data-state="{state.version}" style="padding:0 .8em;font-size:.85em;color:#555">'
        f"picture to pose {1e3 * t.total_s:.0f} ms ({stages}); {rate:.1f} poses a second. {WORDS[state.effort]}</div>"
    )


def kept_words(views: int, landmarks: int) -> str:
    """How much was collected.

    Example:
        >>> kept_words(1, 3)
        '1 view and 3 landmarks'
    """
    return f"{views} view{'s' * (views != 1)} and {landmarks} landmark{'s' * (landmarks != 1)}"


def _share_cell(share: float) -> str:
    text = f"{share:.0f}" if share >= 0.5 else ""
    return f'<td style="text-align:center;background:rgba(30,90,200,{share / 130:.2f})">{text}</td>'


def _css(color: tuple[int, int, int]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*color)
