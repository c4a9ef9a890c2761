"""What the runner `experiment` does: perform, write everything into one folder, whole or not at all."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ursnav_torch.files import Progress, no_progress, whole_folder, write_json
from ursnav_torch.kidney import Kidney
from ursnav_torch.thesis.figures import Figure, compare_figures, results
from ursnav_torch.thesis.report import report_page
from ursnav_torch.thesis.run import Outcome, Pipeline, perform
from ursnav_torch.thesis.settings import ProtocolSettings


def run_experiment(
    kidney: Kidney,
    pipeline: Pipeline,
    settings: ProtocolSettings,
    out: Path,
    *,
    name: str = "default",
    record: Mapping[str, Any] | None = None,
    overwrite: bool = False,
    progress: Progress = no_progress,
) -> tuple[Outcome, list[Figure]]:
    """Do the thesis's experiment and write ``report.html``, ``results.json`` and all data to folder ``out``.

    An interrupted run keeps its VID in ``out.partial``; the same call takes it up.

    Args:
        kidney: the phantom.
        pipeline: what is tested. settings: how.
        out: folder to be made.
        name: of the experiment, for the headline.
        record: the choices as plain data, kept in ``results.json``.
        overwrite: replace what stands there.
        progress: ``progress(total, what)`` gives a context with ``advance(n)``.

    Raises:
        InputError: ``out`` exists, or the experiment cannot be done in this kidney.
    """
    with whole_folder(out, overwrite, resume=True) as work:
        outcome = perform(kidney, pipeline, settings, work, progress)
        figures = compare_figures(outcome)
        write_json(work / "results.json", results(outcome, figures, dict(record or {})))
        renderer = pipeline.make_renderer(kidney.mesh, pipeline.camera)
        (work / "report.html").write_text(report_page(outcome, figures, name, renderer), encoding="utf-8")
        (work / "made_for.txt").unlink()
    return outcome, figures
