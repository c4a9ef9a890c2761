"""From CT to model and to print, against known truth: ``python -m benchmarks.anatomy``.

Phantoms are put into synthetic patients, scanned at 0.7 x 0.7 x 1.0 mm, segmented without a hint, and held against
what went in; the last part reads and segments a scan of 512 x 512 x 600 in a process of its own; then phantoms and
(with ``data=DIR``) real kidneys are printed. Arguments, each ``key=value``: ``phantoms=6`` ``prints=3`` ``big=1``
(0 leaves a part out) ``data=DIR`` ``out=FILE.json``.
"""

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh

from benchmarks.shared.results import Report, overrides
from ursnav_torch.kidney import Kidney, load_mesh_kidney, make_phantom_kidney
from ursnav_torch.kidney.grid import LumenGrid, distance_to_surface
from ursnav_torch.printing import check_print, make_printed_phantom
from ursnav_torch.segmentation import CtKidney, Patient, name_kidney, place_kidney, scan_lumen, synthetic_ct, write_scan

DEFAULTS = {"phantoms": 6, "prints": 3, "big": 1, "data": "", "out": ""}
#: (density of the urine in HU, blur of the scanner in mm, slice in mm)
SCANS = {
    "900 HU": (900.0, 0.5, 1.0),
    "350 HU (thin contrast)": (350.0, 0.5, 1.0),
    "900 HU, blur 0.7 mm": (900.0, 0.7, 1.0),
    "900 HU, slices 2 mm": (900.0, 0.5, 2.0),
}
#: A calyx counts as present if its tip lies in the lumen that was found; tips as found if one lies within this, mm.
TIP_MM = 5.0


def main(arguments: Sequence[str]) -> int:
    """Run the suite, print its tables and write its JSON file."""
    settings = overrides(DEFAULTS, arguments)
    report = Report("anatomy", {k: v for k, v in settings.items() if k != "out"})
    with tempfile.TemporaryDirectory() as scratch:
        for name, (hu, blur, slice_mm) in SCANS.items() if settings["phantoms"] else ():
            _accuracy(report, settings["phantoms"], Path(scratch), name, hu, blur, slice_mm)
        if settings["big"]:
            _big(report, Path(scratch))
    _prints(report, settings["prints"], settings["data"])
    report.finish(settings["out"])
    return 0


def _accuracy(
    report: Report, phantoms: int, scratch: Path, name: str, hu: float, blur_mm: float, slice_mm: float
) -> None:
    surface, volume, seconds, present, found, tips = [], [], [], 0, 0, 0
    for seed in range(phantoms):
        patient = place_kidney(make_phantom_kidney(seed=2000 + seed), ("right", "left")[seed % 2], blur_mm)
        scan = synthetic_ct(
            [patient], (0.7, 0.7, slice_mm), (512, 340, round(120 / slice_mm)), contrast_hu=hu, seed=seed
        )
        write_scan(scan, scratch / "scan.nii")
        start = time.perf_counter()
        ct = scan_lumen(scratch / "scan.nii")
        seconds.append(time.perf_counter() - start)
        surface.append(_between(ct.mesh, patient.mesh))
        volume.append(100 * (ct.mesh.volume / patient.mesh.volume - 1))
        inside, near = _calyces(ct, patient)
        present, found, tips = present + inside, found + near, tips + len(patient.tips_lps)
        print(f"{name}: {seed + 1} of {phantoms}", file=sys.stderr)
    group = f"CT to surface, {name}"
    report.add(group, "surface, mean distance", "mm", [float(d.mean()) for d in surface])
    report.add(group, "surface, 95th percentile", "mm", [float(np.quantile(d, 0.95)) for d in surface])
    report.add(group, "volume, difference", "%", volume)
    report.add(group, "calyces present", "%", [100 * present / tips], f"{present}/{tips}", tips)
    report.add(group, f"calyces named within {TIP_MM:g} mm", "%", [100 * found / tips], f"{found}/{tips}", tips)
    report.add(group, "reading and segmenting", "s", seconds)


def _between(a: trimesh.Trimesh, b: trimesh.Trimesh) -> np.ndarray:
    sides = ((a, b), (b, a))
    return np.concatenate(
        [distance_to_surface(to, trimesh.sample.sample_surface(of, 8000, seed=1)[0], 0.5) for of, to in sides]
    )


def _calyces(ct: CtKidney, patient: Patient) -> tuple[int, int]:
    """How many true tips lie in the lumen found, and how many have a found tip near."""
    inside = LumenGrid.from_mesh(ct.mesh, 0.5).clearance_mm(patient.tips_lps) > 0
    tips = name_kidney(ct, None).tips_mm
    near = np.linalg.norm(tips[None] - patient.tips_lps[:, None], axis=-1).min(axis=1) < TIP_MM
    return int(inside.sum()), int(near.sum())


def _big(report: Report, scratch: Path) -> None:
    """A scan of 512 x 512 x 600 in a process of its own, so that its memory is its own."""
    patients = [place_kidney(make_phantom_kidney(seed=2100)), place_kidney(make_phantom_kidney(seed=2101), "left")]
    scan = synthetic_ct(patients, (0.7, 0.7, 0.8), (512, 512, 600), noise_hu=18.0)
    path = scratch / "big.nii"
    write_scan(scan, path)
    del scan
    command = [sys.executable, "-m", "ursnav_torch.segment", f"kidney.path={path}", "kidney.side=right"]
    start = time.perf_counter()
    done = subprocess.run(
        [*command, f"out={scratch / 'big'}"], check=False, capture_output=True, text=True, env=os.environ
    )
    seconds = time.perf_counter() - start
    if done.returncode:
        report.skip("512 x 512 x 600", done.stderr.strip())
        return
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    memory = used.ru_maxrss / 2**20
    report.add("a scan of 512 x 512 x 600", "runner segment, all", "s", [seconds])
    report.add("a scan of 512 x 512 x 600", "processor time of it", "s", [used.ru_utime + used.ru_stime])
    report.add("a scan of 512 x 512 x 600", "memory at most", "GiB", [memory])


def _prints(report: Report, prints: int, data: str) -> None:
    kidneys: dict[str, Kidney] = {f"phantom {s}": make_phantom_kidney(seed=2200 + s) for s in range(prints)}
    for path in sorted(Path(data).glob("*/lumen.stl")) if data else ():
        kidneys[path.parent.name] = load_mesh_kidney(path, calyces=path.parent / "calyces.csv")
    for name, kidney in kidneys.items():
        start = time.perf_counter()
        phantom = make_printed_phantom(kidney, 1.8, 2.0)
        seconds, check = time.perf_counter() - start, check_print(phantom)
        group = f"printed at 1.8 with walls of 2 mm, {name}"
        report.add(group, "halves closed, one piece each", "of 1", [float(check.watertight)])
        report.add(group, "thinnest wall", "mm", [check.thinnest_wall_mm])
        report.add(group, "thinnest septum", "mm", [check.thinnest_septum_mm], "anatomy; 8 where none is thinner")
        report.add(group, "halves joined against shell, at most", "mm", [check.union_mm])
        report.add(group, "calyces crossed", "calyces", [len(phantom.cut.crossed)], f"of {len(kidney.calyces)}")
        report.add(group, "time", "s", [seconds])
        print(f"printed {name}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
