"""A `match` run: pictures in, CSV and page out."""

import shutil
from pathlib import Path
from typing import Any

from ursnav_torch.columns import MATCH_COLUMNS
from ursnav_torch.errors import InputError
from ursnav_torch.features import read_image
from ursnav_torch.files import Progress, check_output, check_output_file, commit, partial_path, write_csv
from ursnav_torch.localization import Localizer
from ursnav_torch.reports import MatchReport
from ursnav_torch.runs.journal import Journal
from ursnav_torch.runs.pictures import find_images, locate_files


def check_results(out: Path, report: Path | None, overwrite: bool) -> None:
    """Refuse to replace what `match_images` would write to; so that nobody waits for the refusal.

    Raises:
        InputError: see `check_output`.
    """
    check_output_file(out, overwrite)
    if report is not None:
        check_output(report, overwrite)


def match_images(
    localizer: Localizer,
    images: str,
    out: Path,
    report: Path | None,
    overwrite: bool,
    progress: Progress,
    truth: dict[str, str] | None = None,
) -> list[dict[str, Any]]:
    """Locate all pictures of a file, folder or glob, write the CSV and, if asked for, the page with pictures.

    A run that was interrupted goes on after the last picture it had finished.

    Args:
        localizer: the VID and how to search it.
        images: a file, a folder or a glob.
        out: CSV file to be made.
        report: folder to be made for ``index.html``, or None.
        overwrite: replace what stands there.
        progress: ``progress(total, what)`` gives a context with ``advance(n)``.
        truth: true calyx names by picture, shown on the page where known.

    Returns:
        The rows, keyed by `MATCH_COLUMNS`.
    """
    base, paths = find_images(images)
    check_results(out, report, overwrite)
    page = None
    if report is not None:
        if not localizer.vid.image_path(0).exists():
            raise InputError(
                f"The VID {localizer.vid.folder} has no pictures, which a report shows; copy its images/, too, or "
                "leave report= out."
            )
    journal = Journal(partial_path(out), _work(localizer, base, paths, report, truth))
    if report is not None:
        if not journal.done:
            shutil.rmtree(partial_path(report), ignore_errors=True)
        partial_path(report).mkdir(parents=True, exist_ok=True)
        page = MatchReport(partial_path(report), localizer.vid)
    rows = []
    with progress(len(paths), "pictures") as advance:
        for entry in journal.done:
            rows.append(entry["row"])
            if page is not None:
                page.entries.append(entry["page"])
        advance(len(rows))
        left = paths[len(rows) :]
        for path, (row, location) in zip(left, locate_files(localizer, base, left), strict=True):
            rows.append(row)
            if page is not None:
                page.add(row, location, _readable(path), (truth or {}).get(row["image"]))
            journal.add({"row": row, "page": page.entries[-1] if page is not None else None})
            advance(1)
    if page is not None and report is not None:
        page.finish(f"{len(rows)} pictures from {base}, searched among {len(localizer.vid)} views.")
        commit(partial_path(report), report)
    write_csv(out, MATCH_COLUMNS, rows)
    return rows


def _work(
    localizer: Localizer, base: Path, paths: list[Path], report: Path | None, truth: dict[str, str] | None
) -> dict[str, Any]:
    """What an interrupted run must have had in common with this one to be taken up."""
    pictures = [[str(p), p.stat().st_mtime if p.exists() else 0.0] for p in paths]
    description = localizer.vid.folder / "vid.json"
    return {
        "vid": description.read_text(encoding="utf-8") if description.exists() else str(localizer.vid.folder),
        "settings": f"{localizer.matching} {localizer.settings}",
        "base": str(base),
        "pictures": pictures,
        "report": None if report is None else str(report),
        "truth": truth,
    }


def _readable(path: Path) -> Any:
    try:
        return read_image(path)
    except InputError:
        return None
