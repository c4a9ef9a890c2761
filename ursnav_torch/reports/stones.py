"""Stones to be looked at: each one's best picture with its outline, and all of them in the translucent kidney."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ursnav_torch.features.foreground import ForegroundBody
from ursnav_torch.files import write_image
from ursnav_torch.kidney import Kidney
from ursnav_torch.reports.overview import Overview, draw_overview
from ursnav_torch.stones import GONE, FoundStone, StoneWatch, calyx_name, stone_sentences, write_stones

Picture = NDArray[np.uint8]

#: Blue, green, red: of stones that are there, and gone.
THERE_BGR, GONE_BGR = (20, 120, 200), (150, 150, 150)
_TEXT = cv2.FONT_HERSHEY_SIMPLEX
_TILE_PX = 240


@dataclass(frozen=True, slots=True, eq=False)
class StonesTold:
    """What is said and shown of stones: sentences, and the picture (H, W, 3) of `draw_stones`, None for none."""

    sentences: tuple[str, ...] = ()
    picture: Picture | None = None

    def text(self) -> str:
        """A sentence a line."""
        return "\n".join(self.sentences)


NOTHING_TOLD = StonesTold()


def write_stone_files(watch: StoneWatch, table: Path, picture: Path) -> StonesTold:
    """Write the stones' table (CSV) and picture (PNG); returns what there is to say of them and to show."""
    kidney, stones = watch.stones.kidney, watch.found()
    drawn = draw_stones(kidney, watch, stones.seen)
    write_stones(table, stones, kidney)
    write_image(picture, drawn)
    return StonesTold(tuple(stone_sentences(stones, kidney)), drawn)


def mark_stones(picture: Picture, overview: Overview, stones: Iterable[FoundStone]) -> Picture:
    """A picture (S, S, 3) made of an overview, with a disk a stone, as large as it is, and its number."""
    picture = picture.copy()
    for stone in stones:
        x, y = np.rint(overview.project(stone.center_mm[None])[0]).astype(int).tolist()
        radius = max(3, round(stone.size_mm / 2 * overview.px_per_mm))
        color = GONE_BGR if stone.state == GONE else THERE_BGR
        cv2.circle(picture, (x, y), radius, color, 1 if stone.state == GONE else -1, cv2.LINE_AA)
        cv2.circle(picture, (x, y), radius, (30, 30, 30), 1, cv2.LINE_AA)
        for ink, thick in (((255, 255, 255), 3), ((30, 30, 30), 1)):
            cv2.putText(picture, str(stone.number), (x + radius + 2, y + 4), _TEXT, 0.45, ink, thick, cv2.LINE_AA)
    return np.asarray(picture, np.uint8)


def draw_stones(kidney: Kidney, watch: StoneWatch, stones: Sequence[FoundStone], side_px: int = 480) -> Picture:
    """Front and side of the kidney with its stones (S, 2 S, 3), and below them a row a few stones' best pictures."""
    views = [draw_overview(kidney, side_px, from_side) for from_side in (False, True)]
    top = np.concatenate([mark_stones(view.picture, view, stones) for view in views], axis=1)
    columns = top.shape[1] // _TILE_PX
    tiles = [stone_tile(stone, kidney, watch) for stone in stones]
    rows = []
    for begin in range(0, len(tiles), columns):
        row = tiles[begin : begin + columns]
        row += [np.full_like(row[0], 255)] * (columns - len(row))
        rows.append(np.concatenate(row, axis=1))
    return np.asarray(np.concatenate([top, *rows]), np.uint8)


def stone_tile(stone: FoundStone, kidney: Kidney, watch: StoneWatch) -> Picture:
    """A stone's best picture with what lies before the wall outlined, and a line below it (T + 20, T, 3)."""
    tile = np.full((_TILE_PX + 20, _TILE_PX, 3), 255, np.uint8)
    kept = watch.picture_of(stone)
    if kept is not None:
        tile[:_TILE_PX] = cv2.resize(outlined(*kept), (_TILE_PX, _TILE_PX), interpolation=cv2.INTER_AREA)
    name = calyx_name(stone, kidney)
    words = f"{stone.number}: {stone.size_mm:.1f} +- {stone.size_sd_mm:.1f} mm{f' in {name}' if name else ''}"
    words += ", gone" if stone.state == GONE else ""
    cv2.putText(tile, words, (4, _TILE_PX + 14), _TEXT, 0.42, (30, 30, 30), 1, cv2.LINE_AA)
    return tile


def outlined(image: Picture, bodies: Iterable[ForegroundBody]) -> Picture:
    """A picture (H, W) or (H, W, 3) with the stones' outlines (H, W, 3)."""
    shown = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy()
    for body in bodies:
        if body.kind == "stone":
            mask = cv2.resize(body.mask.astype(np.uint8), shown.shape[1::-1], interpolation=cv2.INTER_NEAREST)
            contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
            cv2.drawContours(shown, contours, -1, (255, 160, 0), 1)
    return np.asarray(shown, np.uint8)
