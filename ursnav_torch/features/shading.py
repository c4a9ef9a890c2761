"""Shading correction: what a beam and a vignette leave in a picture's detail towards its rim, fitted and taken out.

A beam narrower than the lens, beside it or turned, and the lens's vignette darken a picture towards its rim faster than
any plane through the surroundings follows; a drawn view has nothing of the kind. Microscopes are corrected by a smooth
surface fitted to each picture, too (Likar et al., Retrospective shading correction based on entropy minimization, J.
Microsc. 197:285, 2000). Here it is fitted to the detail, in the outer part alone, where the wall has seldom anything
that is the same all around, and only as far as it looks like a beam. A rim that is all black looks like none and stays
as it is.
"""

import numpy as np
import torch
from torch import Tensor

from ursnav_torch.camera import Camera

#: The surface rises from this share of the radius on, and is fitted from `_FITTED` on.
INNER = 0.5
_FITTED = 0.4
#: Waves around the picture: none for a beam along the axis, one for a beam beside it.
WAVES = 1
#: Walls alone give surfaces of this size (root mean square, log units; the median of drawn views), which are no
#: shading: a fitted surface is shrunk towards 0 by as much (James and Stein, 1961, positive part).
FAINT = 0.007
#: A light that falls off ever faster leaves a bulge: the mean of its surface is a large share of its size; drawn walls
#: leave hollows more often. One with a smaller share than this counts less, and none from 0 on. Set, not varied.
BULGE = 0.4
#: Robust regression: so many rounds of Cauchy's weights at so many median residuals.
_ROUNDS, _CAUCHY = 4, 1.5
_RIDGE = 1e-3
#: Every so many pixels are asked, and the surface is left out where fewer answer.
_EVERY, _LEAST_PIXELS = 4, 60


class RimShading:
    """The shading of pictures of one lens, by iteratively reweighted least squares.

    Its surface is linear and quadratic in the distance from the axis beyond `INNER`, each times a Fourier series in
    the angle up to `WAVES`; it is 0 farther inside. `INNER`, `WAVES` and `FAINT` were chosen by ``python -m
    benchmarks.causes phantoms=4``, whose notes tell.

    Args:
        camera: the lens at the working size.
        mask: (H, W) 1.0 inside the picture.
    """

    def __init__(self, camera: Camera, mask: Tensor) -> None:
        center = zip(mask.shape, (camera.cy, camera.cx), strict=True)
        y, x = (torch.arange(n, dtype=torch.float32) - c for n, c in center)
        radius = float(mask.sum() / np.pi) ** 0.5
        far = torch.hypot(x[None], y[:, None]) / max(radius, 1.0)
        angle = torch.atan2(y[:, None].expand(mask.shape), x[None].expand(mask.shape))
        rise = (far - INNER).clamp_min(0)
        around = [torch.ones_like(far), *(f(k * angle) for k in range(1, WAVES + 1) for f in (torch.cos, torch.sin))]
        surfaces = torch.stack([growth * wave for growth in (rise, rise * rise) for wave in around])
        self._surfaces, self._inside = (surfaces * mask).flatten(1).numpy(), max(1.0, float(mask.sum()))
        self._fitted = ((far > _FITTED) & (mask > 0)).flatten().nonzero().flatten()[::_EVERY].numpy()
        level = np.ones((1, len(self._fitted)), np.float32)
        self._columns = np.concatenate([level, surfaces.flatten(1).numpy().take(self._fitted, 1)])
        self._held = 1 + _RIDGE * np.eye(len(self._columns), dtype=np.float32)

    def __call__(self, detail: Tensor) -> Tensor:
        """The shading (H, W) in a detail (H, W), see `LocalPlane.detail`; 0 where the lens shows too little to tell."""
        if len(self._fitted) < _LEAST_PIXELS:
            return torch.zeros_like(detail)
        values, columns = detail.flatten().numpy()[self._fitted], self._columns
        weight, middle = np.ones(len(values), np.float32), (len(values) - 1) // 2
        for _ in range(_ROUNDS):
            weighted = columns * weight
            normal = (weighted @ columns.T) * self._held
            found = np.linalg.solve(normal, (weighted * values).sum(1))
            left = values - found @ columns
            scale = _CAUCHY * max(float(np.partition(np.abs(left), middle)[middle]), 1e-4)
            weight = 1 / (1 + np.square(left / np.float32(scale)))
        surface = (found[1:] @ self._surfaces).reshape(detail.shape)
        size = max(float(np.square(surface).sum() / self._inside) ** 0.5, 1e-6)
        bulge = float(surface.sum() / self._inside) / size
        counts = max(0.0, 1 - (FAINT / size) ** 2) * min(max(bulge / BULGE, 0.0), 1.0)
        return torch.from_numpy(surface * np.float32(counts))
