"""The anatomy: the lumen of a kidney's collecting system, its centerline tree, its calyces and their names.

`load_mesh_kidney` and `make_phantom_kidney` make a `Kidney`; `LumenDistance` measures along its lumen and
`observed_calyx` says which calyx a camera observes. Nothing here knows a camera's lens.
"""

from ursnav_torch.kidney.anatomy import Calyx, Centerline, Kidney
from ursnav_torch.kidney.lumen import OBSERVED_WITHIN_MM, LumenDistance, branch_calyx, observed_calyx
from ursnav_torch.kidney.mesh import load_mesh_kidney
from ursnav_torch.kidney.phantom import make_phantom_kidney
from ursnav_torch.kidney.set_words import NO_CALYX, set_words
from ursnav_torch.kidney.tables import read_calyces, read_centerline, write_calyces, write_centerline

__all__ = [
    "NO_CALYX",
    "OBSERVED_WITHIN_MM",
    "Calyx",
    "Centerline",
    "Kidney",
    "LumenDistance",
    "branch_calyx",
    "load_mesh_kidney",
    "make_phantom_kidney",
    "observed_calyx",
    "read_calyces",
    "read_centerline",
    "set_words",
    "write_calyces",
    "write_centerline",
]
