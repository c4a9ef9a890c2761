"""A kidney as a phantom to print: an even wall around the lumen, two halves, pins between them, landmarks outside.

The thesis printed its kidney at 1.8 in two halves, cut where the seam crosses the fewest calyces (§3.2.2); here that
plane is searched. Needs manifold3d of the extra ``ct``.
"""

from ursnav_torch.printing.cut import Cut, calyx_regions, find_cut
from ursnav_torch.printing.measure import PrintCheck, check_print
from ursnav_torch.printing.phantom import PrintedPhantom, make_printed_phantom
from ursnav_torch.printing.picture import print_picture
from ursnav_torch.printing.write import write_phantom

__all__ = [
    "Cut",
    "PrintCheck",
    "PrintedPhantom",
    "calyx_regions",
    "check_print",
    "find_cut",
    "make_printed_phantom",
    "print_picture",
    "write_phantom",
]
