"""`match` leaves out what never changes in its pictures."""

from pathlib import Path

import cv2
import numpy as np

from ursnav_torch.files import no_progress
from ursnav_torch.localization import LocalizationSettings, Localizer
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.runs.match import match_images
from ursnav_torch.vid import Vid


def test_text_burnt_into_the_pictures_is_left_out(vid: Vid, renderer: RaycastRenderer, tmp_path: Path) -> None:
    rng, folder = np.random.default_rng(2), tmp_path / "in"
    folder.mkdir()
    rows = rng.choice(np.flatnonzero(vid.calyx >= 0), 14, replace=False)
    for number, row in enumerate(rows):
        image = renderer.render(vid.T_kidney_camera[row]).image
        image = np.repeat((image * rng.uniform(0.5, 1)).astype(np.uint8)[..., None], 3, 2)
        size = image.shape[0]
        cv2.rectangle(image, (size // 4, size // 6), (3 * size // 4, size // 3), (250, 250, 250), -1)
        cv2.putText(image, "12:04", (size // 4, size // 3 - 4), cv2.FONT_HERSHEY_SIMPLEX, size / 250, (0, 0, 0), 2)
        cv2.imwrite(str(folder / f"{number:02d}.png"), image)
    localizer = Localizer(vid, settings=LocalizationSettings(refine=False))
    found = match_images(localizer, str(folder), tmp_path / "out.csv", None, False, no_progress)
    right = [row.get("calyx") == vid.calyx_name(int(vid.calyx[view])) for row, view in zip(found, rows, strict=True)]
    features = localizer.features(cv2.imread(str(folder / "00.png")))
    height, width = features.valid.shape
    assert float(features.valid[height // 5 : height // 4, 2 * width // 5 : 3 * width // 5].max()) == 0
    assert np.mean(right) >= 0.7
