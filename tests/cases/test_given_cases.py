"""What people reported elsewhere, given to runners and readers: refused with the true reason, in no Python's words.

Every kind of fault has further inputs of our own making, kept with the room that reads them:

==== ============================================= ===========================================================
kind what is wrong                                  inputs of our own
==== ============================================= ===========================================================
A    geometry that a file lacks is filled in        segmentation/test_scan_headers: no spacing, no orientation,
                                                    two spacings, other units, a named orientation alone, places
                                                    that are no numbers; ground_floor/test_units: centimeters,
                                                    inches, meters under names in mm
B    a lens is not checked for sense                camera/test_lens_files: folds, another resolution, columns
                                                    for rows, skew, radians, distortion in others' words or of no
                                                    model
C    EM tables are joined and trusted blindly       em_log/test_read_em and test_join: units, clocks, numbers
                                                    from 1, a clock that jumps back, -1 and 999, frozen readings;
                                                    test_plausible: units that the columns lie about, clocks that
                                                    stand, wrap, are set, two sensors, frame numbers of others
D    trackers' words for "not seen"                 devices/test_openigtlink, test_ndi, test_ros, test_wire,
                                                    em_log/test_sequence
E    "truncated" is guessed                         segmentation/test_dicom: three compressions, reports,
                                                    enhanced files; test_scan_headers: slopes, packed by name,
                                                    damaged and not short, a MetaImage's packed or separate data;
                                                    features/test_image: bytes behind a picture's end
F    several things in one file                     features/test_image: pages, MPO, animated PNG; segmentation:
                                                    phases, series, patients, values a voxel; camera: two cameras
G    the wrong cause is named                       devices/test_grbl: greetings, axes; kidney/test_mesh_kidney:
                                                    bytes after, files of another kind than their name says;
                                                    segmentation/test_ct_markups: units; test_dicom: copies; separators
==== ============================================= ===========================================================

`test_every_case` gives all given files to the runners that take them.
"""

import re
import socket
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ursnav_torch.camera import load_camera
from ursnav_torch.devices import OpenIgtlTracker
from ursnav_torch.devices.igtl.messages import Message, pack_message, pack_transform
from ursnav_torch.em_log import read_em_samples
from ursnav_torch.errors import UrsnavError
from ursnav_torch.features import read_image
from ursnav_torch.kidney import read_calyces, read_centerline
from ursnav_torch.kidney.mesh import read_mesh
from ursnav_torch.registration import Registration, read_landmarks
from ursnav_torch.runs.track_files import read_track, read_truth
from ursnav_torch.segmentation import read_markups
from ursnav_torch.vid import Vid

#: ``KeyError``, ``numpy.linalg.LinAlgError``, a traceback, what the runners say of an error that nobody expected.
BARE = re.compile(r"\b\w*[a-z](?:Error|Exception)\b(?!=)|Traceback|HYDRA_FULL_ERROR")
CASES = {
    "06 NRRD": ("segment", "kidney.path={cases}/06-nrrd-without-spacing/noheader.nrrd", "spacing"),
    "06 MetaImage": ("segment", "kidney.path={cases}/06-nrrd-without-spacing/nospacing.mhd", "spacing"),
    "06 NIfTI": ("segment", "kidney.path={cases}/06-nrrd-without-spacing/pixdim0.nii.gz", "spacing|pixdim"),
    "08 fold": ("build_vid", "camera=file camera.path={cases}/08-lens-that-folds/fold.json", r"71\.9|72"),
    "08 fold2": ("build_vid", "camera=file camera.path={cases}/08-lens-that-folds/fold2.json", "degrees"),
    "12 landmarks": (
        "register",
        "landmarks={cases}/12-decimal-commas/landmarks.csv",
        "line 2.*12 cells.*decimal commas",
    ),
    "17 stack": ("match", "vid={vid} images={cases}/17-tiff-stack/15_stack.tif", "3 pictures"),
}


@pytest.mark.parametrize("name", CASES)
def test_a_runner_tells_the_true_reason(name: str, run: Callable[..., Any], vid: Vid, cases: Path) -> None:
    runner, overrides, reason = CASES[name]
    done = run(runner, *overrides.format(cases=cases, vid=vid.folder).split(" "), "out=o.json")
    said = done.out + done.err
    made = Path("o.json")
    rows = made.read_text(encoding="utf-8") if done.code == 3 else ""
    assert done.code in (1, 3) and re.search(reason, said + rows), said + rows
    assert not BARE.search(said + rows)
    assert done.code == 3 or not made.exists()


def test_decimal_commas_are_told_wherever_they_stand(cases: Path) -> None:
    folder = cases / "12-decimal-commas"
    for read, name, cells in ((read_em_samples, "em.csv", 8), (read_calyces, "calyces.csv", 7)):
        with pytest.raises(UrsnavError, match=rf"line 2.*{cells} cells.*decimal commas"):
            read(folder / name)  # type: ignore[operator]
    assert len(read_landmarks(folder / "landmarks_control.csv").em_mm)


def test_a_byte_order_mark_is_passed_over(cases: Path) -> None:
    assert load_camera(cases / "22-camera-json-with-bom" / "bom.json").width > 0


@pytest.mark.parametrize("none", [np.zeros((4, 4)), np.full((4, 4), np.nan)], ids=["zero", "nan"])
def test_the_41st_of_240_transforms_is_no_pose_and_the_others_are(none: np.ndarray) -> None:
    sent = [
        pack_message(Message("TRANSFORM", "Tip", pack_transform(none if i == 40 else np.eye(4)))) for i in range(240)
    ]
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def serve() -> None:
            client, _ = listener.accept()
            with client:
                client.sendall(b"".join(sent))
                client.recv(1)  # until the tracker leaves

        thread = threading.Thread(target=serve)
        thread.start()
        with OpenIgtlTracker("Tip", port=listener.getsockname()[1]) as tracker:
            seen = [tracker.read(10.0).visible for _ in range(240)]
        thread.join()
    assert seen == [i != 40 for i in range(240)]


#: What reads the files that a fuzzer found, by how their names begin.
READERS: dict[str, Callable[[Path], object]] = {
    "camera": load_camera,
    "centerline": lambda path: read_centerline(path, list("ABCDEFGH")),
    "em": read_em_samples,
    "image": read_image,
    "landmarks": read_landmarks,
    "m.mrk": read_markups,
    "mesh": read_mesh,
    "registration": Registration.from_json,
    "track": read_track,
    "truth": read_truth,
    "vid+sum_calyces": read_calyces,
}


def test_what_a_fuzzer_found_is_refused_in_words_or_read(cases: Path) -> None:
    asked = 0
    for path in sorted((cases / "fuzz").iterdir()):
        read = next((reader for name, reader in READERS.items() if path.name.startswith(name)), None)
        if read is None:
            continue
        asked += 1
        try:
            read(path)
        except UrsnavError as error:
            assert not BARE.search(str(error)), f"{path.name}: {error}"
    assert asked > 150
