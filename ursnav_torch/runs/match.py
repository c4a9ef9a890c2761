"""A `match` run: pictures in, CSV and page out."""

import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from ursnav_torch.camera import PictureCut
from ursnav_torch.columns import MATCH_COLUMNS
from ursnav_torch.errors import InputError
from ursnav_torch.features import scene_of
from ursnav_torch.files import Progress, fingerprint, write_csv
from ursnav_torch.localization import Localizer, Location
from ursnav_torch.reports import MatchReport
from ursnav_torch.results import check_set, whole_set
from ursnav_torch.runs.journal import Journal
from ursnav_torch.runs.pictures import Pictures, find_images, locate_files

#: Pictures that are looked at for what never changes in them.
_LOOKED_AT = 32


def check_results(out: Path, report: Path | None, overwrite: bool) -> None:
    """Refuse to replace what `match_images` would write to; so that nobody waits for the refusal.

    Raises:
        InputError: see `check_set`.
    """
    check_set(_results(out, report), overwrite)


def match_images(
    localizer: Localizer,
    images: str,
    out: Path,
    report: Path | None,
    overwrite: bool,
    progress: Progress,
    truth: dict[str, str] | None = None,
    children: int = 0,
    cut: PictureCut | None = None,
) -> list[dict[str, Any]]:
    """Locate all pictures of a file, folder or glob, write the CSV and, if asked for, the page with pictures.

    A run that was interrupted goes on after the last picture it had finished. CSV and page appear as one.

    Args:
        localizer: the VID and how to search it.
        images: a file, a folder or a glob.
        out: CSV file to be made.
        report: folder to be made for ``index.html``, or None.
        overwrite: replace what stands there.
        progress: ``progress(total, what)`` gives a context with ``advance(n)``.
        truth: true calyx names by picture, shown on the page where known.
        children: processes that locate while this one writes the page; rows are the same but for their seconds.
        cut: what part of the VID's lens's pictures these are; None: all of it.

    Returns:
        The rows, keyed by `MATCH_COLUMNS`.

    Raises:
        InputError: there is no picture, a result exists, another process writes it, or the disk is full.
    """
    base, paths = find_images(images)
    check_results(out, report, overwrite)
    if report is not None and not localizer.vid.image_path(0).exists():
        raise InputError(
            f"The VID {localizer.vid.folder} has no pictures, which a report shows; copy its images/, too, or "
            "leave report= out."
        )
    pictures = Pictures(base, paths, cut or localizer.vid.cut_of(None))
    work = _work(localizer, pictures, report, truth)
    with whole_set(_results(out, report), overwrite, work, resume=True) as whole:
        if whole.outcome is None:
            _narrow(localizer, pictures)
            journal = Journal(whole.folder / "journal.jsonl", work, pictures.names())
            page = None if report is None else _page(whole.staged(report), localizer, journal)
            located = locate_files(localizer, pictures.after(len(journal.done)), children)
            rows = _journaled(located, pictures, journal, page, progress, truth or {})
            if page is not None:
                page.finish(f"{len(rows)} pictures of “{base.name}” were searched among {len(localizer.vid)} views.")
            write_csv(whole.staged(out), MATCH_COLUMNS, rows)
            whole.outcome = rows
    return list(whole.outcome)


def _narrow(localizer: Localizer, pictures: Pictures) -> None:
    """Let the localizer leave out what was cut away, and what never changes: a narrower mask, burnt-in text."""
    paths = pictures.paths
    if pictures.cut.narrows:
        localizer.narrow(pictures.cut.inside())
    rows = np.unique(np.linspace(0, len(paths) - 1, min(len(paths), _LOOKED_AT)).round().astype(int))
    shown = [image for row in rows if (image := pictures.readable(paths[row])) is not None]
    scene = scene_of(shown, localizer.vid.camera.pixel_rays()[1])
    if scene is not None:
        localizer.narrow(scene)


def _results(out: Path, report: Path | None) -> tuple[Path, ...]:
    return (out,) if report is None else (out, report)


def _page(folder: Path, localizer: Localizer, journal: Journal) -> MatchReport:
    """The page with what the journal knows; pictures of entries that were never finished are overwritten."""
    if not journal.done:
        shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(exist_ok=True)
    page = MatchReport(folder, localizer.vid)
    page.entries.extend(entry["page"] for entry in journal.done)
    return page


def _journaled(
    located: Iterable[tuple[dict[str, Any], Location | None]],
    pictures: Pictures,
    journal: Journal,
    page: MatchReport | None,
    progress: Progress,
    truth: dict[str, str],
) -> list[dict[str, Any]]:
    """A row a picture: those of the journal, then the others as they are located, which are added to it."""
    rows = [entry["row"] for entry in journal.done]
    with progress(len(pictures.paths), "pictures") as advance:
        advance(len(rows))
        for path, (row, location) in zip(pictures.after(len(rows)).paths, located, strict=True):
            rows.append(row)
            if page is not None:
                page.add(row, location, pictures.readable(path), truth.get(row["image"]))
            journal.add({"row": row, "page": page.entries[-1] if page is not None else None})
            advance(1)
    return rows


def _work(
    localizer: Localizer, pictures: Pictures, report: Path | None, truth: dict[str, str] | None
) -> dict[str, Any]:
    """What an interrupted run must have had in common with this one to be taken up: every byte that goes in."""
    description = localizer.vid.folder / "vid.json"
    return {
        "vid": description.read_text(encoding="utf-8") if description.exists() else str(localizer.vid.folder),
        "settings": localizer.described(),
        "base": str(pictures.base),
        "pictures": [[str(path), *fingerprint(path)] for path in pictures.paths],
        "cut": pictures.cut.numbers(),
        "report": None if report is None else str(report),
        "truth": truth,
    }
