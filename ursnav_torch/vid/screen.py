"""What a large VID holds so that it opens at once and is searched in two stages.

Beside the features, which stay on the disk until they are asked for: a few numbers a view to scan all of them by (see
`features.steerable`), the poses as numbers, and a checksum of every view's features, proven when they are read.
"""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from ursnav_torch.errors import InputError
from ursnav_torch.features.steerable import SteerableBasis, learn_basis
from ursnav_torch.vid.base import Vid, ViewFeatures

#: A VID of so many views is screened: all its spectra would take 0.2 GB, and their scan 60 ms.
SCREEN_FROM = 10_000
#: Components a view; ``python -m benchmarks.screening`` tells how often the exact search's answer is kept.
COMPONENTS = 128
_VIEWS_AT_A_TIME = 1_000
#: What the file holds, and in which kind of numbers.
_KINDS = {
    "frequency": torch.int64,
    "vectors": torch.float32,
    "sectors": torch.int64,
    "table": torch.float16,
    "sums": torch.uint8,
    "T_kidney_camera": torch.float64,
    "calyx": torch.int64,
}


@dataclass(frozen=True, slots=True, eq=False)
class Screen:
    """The coarse stage of a VID of V views.

    Attributes:
        basis: K components of the polar maps.
        table: (2 K, V) float16, every view's coefficients, real parts first.
        sums: (V, 32) uint8, sha256 of each view's features.
        proven: (V,) bool, views whose features were found to be as they were built; filled as they are read.
    """

    basis: SteerableBasis
    table: Tensor
    sums: NDArray[np.uint8]
    proven: NDArray[np.bool_]

    def prove(self, features: ViewFeatures, views: NDArray[np.int64], where: Path) -> None:
        """Compare views (K,) with their checksums, once each; ``where`` is the VID's folder, for the error.

        Raises:
            InputError: a view's features were changed after the VID was built.
        """
        for view in views[~self.proven[views]].tolist():
            if _sum_of(features, view) != self.sums[view].tobytes():
                raise InputError(
                    f"The features of view {view} of the VID {where} were changed after it was built; copy it again "
                    "or build it again."
                )
            self.proven[view] = True


def make_screen(features: ViewFeatures, components: int = COMPONENTS) -> Screen | None:
    """The screen of a VID's features; None for those without polar maps, by which it screens."""
    if not features.maps.numel():
        return None
    basis = learn_basis(features.maps, components)
    table = torch.empty(2 * len(basis), len(features), dtype=torch.float16)
    for some, out in zip(features.maps.split(_VIEWS_AT_A_TIME), table.split(_VIEWS_AT_A_TIME, 1), strict=True):
        out.copy_(basis.table(some))
    sums = [np.frombuffer(_sum_of(features, view), np.uint8) for view in range(len(features))]
    return Screen(basis, table, np.stack(sums), np.ones(len(features), bool))


def save_screen(path: Path, vid: Vid) -> None:
    """Write a VID's screen, poses and calyces as safetensors, readable by whom the umask lets read."""
    screen = vid.screen
    assert screen is not None
    path.touch()
    mode = path.stat().st_mode
    tensors = {
        "frequency": screen.basis.frequency,
        "vectors": screen.basis.vectors,
        "sectors": torch.tensor([screen.basis.sectors]),
        "table": screen.table,
        "sums": torch.from_numpy(screen.sums),
        "T_kidney_camera": torch.from_numpy(vid.T_kidney_camera),
        "calyx": torch.from_numpy(vid.calyx),
    }
    save_file({name: tensor.contiguous() for name, tensor in tensors.items()}, str(path))
    path.chmod(mode)


def load_screen(path: Path) -> tuple[Screen, NDArray[np.float64], NDArray[np.int64]]:
    """A screen that `save_screen` wrote, with the views' poses (V, 4, 4) and calyces (V,), all memory-mapped.

    Raises:
        InputError: damaged, or not such a file.
    """
    try:
        data = load_file(str(path))
        tensors = [data[name] for name in _KINDS]
    except (SafetensorError, KeyError, OSError) as error:
        raise InputError(f"{path} is damaged ({error}); copy it again or build the VID again.") from None
    views, components = len(data["T_kidney_camera"]), len(data["frequency"])
    width = data["vectors"].shape[1] if data["vectors"].ndim == 3 else -1
    wanted = [
        (components,),
        (components, width, 2),
        (1,),
        (2 * components, views),
        (views, 32),
        (views, 4, 4),
        (views,),
    ]
    found = [(tensor.dtype, tuple(tensor.shape)) for tensor in tensors]
    if found != list(zip(_KINDS.values(), wanted, strict=True)):
        raise InputError(
            f"{path} holds {dict(zip(_KINDS, found, strict=True))}, which do not fit; build the VID again."
        )
    basis = SteerableBasis(data["frequency"], data["vectors"], int(data["sectors"][0]))
    T, calyx, sums = (data[name].numpy() for name in ("T_kidney_camera", "calyx", "sums"))
    return Screen(basis, data["table"], sums, np.zeros(views, bool)), T, calyx


def _sum_of(features: ViewFeatures, view: int) -> bytes:
    """The sha256 of one view's features."""
    digest = hashlib.sha256()
    for field in (features.points, features.mask, features.direction, features.weight, features.points_kidney,
                  features.maps):  # fmt: skip
        digest.update(field[view].numpy().tobytes())
    return digest.digest()
