"""What the package knows, judged on pictures that the project did not draw."""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.certainty.figures import Told, report_told, told
from benchmarks.shared.kidneys import stills, vid_of
from benchmarks.shared.results import Report
from ursnav_torch.errors import InputError
from ursnav_torch.features import read_image
from ursnav_torch.files import write_json
from ursnav_torch.localization import Localizer, Query
from ursnav_torch.localization.fitting import NOTHING
from ursnav_torch.localization.learn import ask
from ursnav_torch.localization.learned import asked_from_table, certainty_model, evidence_table
from ursnav_torch.vid import Vid

#: Folders of stills, where a kidney has them.
STYLES = ("simulation", "phantom", "invivo", "tissue")


def judge_kidneys(report: Report, folder: Path, work: Path, risk: float, probability: float) -> None:
    """Every style of every kidney that has stills, and all kidneys together.

    Raises:
        InputError: there is no such kidney.
    """
    names = sorted(
        p.parent.relative_to(folder).as_posix()
        for p in [*folder.glob("*/lumen.stl"), *folder.glob("*/*/lumen.stl")]
        if any((p.parent / style / "truth.csv").is_file() for style in STYLES)
    )
    if not names:
        raise InputError(f"No kidneys with stills ({', '.join(STYLES)}) in {folder}.")
    everything: list[Told] = []
    for name in names:
        vid = vid_of(folder, name, work)
        asked = asked_from_table(_rows(vid, folder, name, work), True)
        settings = Localizer.settings_line(vid.settings)
        model = certainty_model(vid.calibration, settings, True)
        if model is None:
            raise InputError(f"Nothing is known of certainty with {settings}; run with save=true first.")
        everything += told(model, asked, risk, probability)
    report_told(report, f"pictures in {folder.name}", everything)


def _rows(vid: Vid, folder: Path, name: str, work: Path) -> list[dict[str, Any]]:
    """Plain rows of one kidney's pictures, from the work folder where they lie there already."""
    path, settings = work / f"certainty_{name.replace('/', '_')}.json", Localizer.settings_line(vid.settings)
    if path.exists():
        kept = json.loads(path.read_text(encoding="utf-8"))
        if kept["settings"] == settings:
            return list(kept["rows"])
    asked = ask(Localizer(vid), _queries(vid, folder, name), lambda n: None)
    rows = [row | {"kind": a["kind"]} for row, a in zip(evidence_table(asked), asked, strict=True)]
    write_json(path, {"settings": settings, "rows": rows})
    print(f"{name}: {len(rows)} pictures asked", file=sys.stderr, flush=True)
    return rows


def _queries(vid: Vid, folder: Path, name: str) -> Iterator[Query]:
    names = {c.name: i for i, c in enumerate(vid.kidney.calyces)}
    for style in STYLES:
        if (folder / name / style / "truth.csv").is_file():
            for still in stills(folder, name, style):
                yield Query(still.image, still.T_kidney_camera, names.get(still.calyx, -1), style)
    for path in sorted((folder / name / "none").glob("*.jpg")):
        yield Query(read_image(path), np.full((4, 4), np.nan), NOTHING, "none")
