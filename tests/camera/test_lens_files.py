"""Lens files of other programs put every ray where those programs say, or are refused with what is wrong."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from ursnav_torch.camera import Camera, load_camera, mask_text
from ursnav_torch.errors import InputError

W, H, F = 320, 240, (150.0, 148.0, 158.0, 121.0)
RADTAN = (-0.21, 0.05, 0.001, -0.002)
RATIONAL = (-0.3, 0.12, 0.001, -0.0015, 0.02, 0.05, 0.01, 0.004)
FISHEYE = (-0.03, 0.004, -0.001, 0.0002)

ROS = """image_width: {W}
image_height: {H}
camera_name: scope
camera_matrix: {{rows: 3, cols: 3, data: [{fx}, 0, {cx}, 0, {fy}, {cy}, 0, 0, 1]}}
distortion_model: {model}
distortion_coefficients: {{rows: 1, cols: {n}, data: {k}}}
"""
KALIBR = """cam0:
  camera_model: {camera}
  intrinsics: {intrinsics}
  distortion_model: {model}
  distortion_coeffs: {k}
  resolution: [{W}, {H}]
"""
OCAM = """#polynomial coefficients for the DIRECT mapping function

5 {a}

#polynomial coefficients for the inverse mapping function
3 200 100 1

#center: "row" and "column", starting from 0 (C convention)

{row} {column}

#affine parameters "c", "d", "e"

{c} {d} {e}

#image size: "height" and "width"

{H} {W}
"""


def write(path: Path, text: str, **words: object) -> Path:
    fx, fy, cx, cy = F
    path.write_text(text.format(**{"W": W, "H": H, "fx": fx, "fy": fy, "cx": cx, "cy": cy} | words), encoding="utf-8")
    return path


def storage(path: Path, k: tuple[float, ...], **more: float) -> Path:
    fx, fy, cx, cy = F
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    file.write("image_width", W)
    file.write("image_height", H)
    file.write("camera_matrix", np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]))
    file.write("distortion_coefficients", np.array(k).reshape(-1, 1))
    for name, value in more.items():
        file.write(name, value)
    file.release()
    return path


def spread(limit_deg: float = 40.0) -> np.ndarray:
    angle = np.radians(np.linspace(0, limit_deg, 30))[:, None]
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    return np.stack(np.broadcast_arrays(np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)), -1)


def opencv_pixels(points: np.ndarray, k: tuple[float, ...], fisheye: bool) -> np.ndarray:
    fx, fy, cx, cy = F
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    flat, none = points.reshape(-1, 1, 3), np.zeros(3)
    project = cv2.fisheye.projectPoints if fisheye else cv2.projectPoints
    found = project(flat, none, none, K, np.array(k))[0]
    return found.reshape(*points.shape[:-1], 2)


def covers(lens: Camera) -> None:
    """Every pixel's ray projects back onto it."""
    u, v = np.meshgrid(np.arange(0, lens.width, 3), np.arange(0, lens.height, 3))
    pixels = np.stack([u, v], -1)
    rays, inside = lens.rays(pixels)
    assert inside.all()
    np.testing.assert_allclose(lens.project(rays)[0], pixels, atol=0.01)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1)


@pytest.mark.parametrize("kind", ["ros", "kalibr", "opencv.yml", "opencv.xml", "colmap"])
@pytest.mark.parametrize(
    ("k", "fisheye"), [(RADTAN, False), ((*RADTAN, 0.01), False), (RATIONAL, False), (FISHEYE, True), ((), False)]
)
def test_five_formats_agree_with_opencv_over_the_whole_picture(
    tmp_path: Path, kind: str, k: tuple[float, ...], fisheye: bool
) -> None:
    cx, cy = F[2:]
    if kind == "kalibr" and len(k) > 4:
        pytest.skip("Kalibr has four coefficients")
    if kind == "ros":
        model = "equidistant" if fisheye else "rational_polynomial" if len(k) == 8 else "plumb_bob"
        path = write(tmp_path / "lens.yaml", ROS, model=model, k=list(k), n=len(k))
    elif kind == "kalibr":
        model = ("equidistant" if fisheye else "radtan") if k else "none"
        path = write(tmp_path / "lens.yaml", KALIBR, camera="pinhole", intrinsics=list(F), model=model, k=list(k))
    elif kind == "colmap":
        model = {0: "PINHOLE", 4: "OPENCV_FISHEYE" if fisheye else "OPENCV"}.get(len(k), "FULL_OPENCV")
        values = [*F[:2], cx + 0.5, cy + 0.5, *(k if len(k) in (0, 4) else (*k, 0, 0, 0)[:8])]
        text = "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n1 {model} {W} {H} {values}\n"
        path = write(tmp_path / "cameras.txt", text, model=model, values=" ".join(map(str, values)))
    else:
        path = storage(tmp_path / f"lens{Path(kind).suffix}", k, fisheye_model=int(fisheye))
    lens = load_camera(path)
    points = spread()
    np.testing.assert_allclose(lens.project(points)[0], opencv_pixels(points, k or (0.0,) * 4, fisheye), atol=1e-6)
    covers(lens)


@pytest.mark.parametrize(("xi", "alpha"), [(-0.2, 0.59), (0.1, 0.3), (0.9, 0.0)])
def test_double_sphere_and_omni_of_kalibr(tmp_path: Path, xi: float, alpha: float) -> None:
    """Against the formulas of Usenko, Demmel and Cremers (3DV 2018), eq. 40 to 42, written out."""
    values = [xi, alpha, *F] if alpha else [xi, *F]
    camera = "ds" if alpha else "omni"
    path = write(tmp_path / "c.yaml", KALIBR, camera=camera, intrinsics=values, model="none", k=[])
    lens, p = load_camera(path), spread(80)
    x, y, z = np.moveaxis(p, -1, 0)
    d1 = np.sqrt(x * x + y * y + z * z)
    d2 = np.sqrt(x * x + y * y + (xi * d1 + z) ** 2)
    below = alpha * d2 + (1 - alpha) * (xi * d1 + z)
    expected = np.stack([F[0] * x / below + F[2], F[1] * y / below + F[3]], -1)
    np.testing.assert_allclose(lens.project(p)[0], expected, atol=1e-9)
    covers(lens)


def test_ocamcalib_looks_where_its_own_formula_does(tmp_path: Path) -> None:
    a, (c, d, e), (row, column) = [-150.0, 0.0, 0.0012, -1e-6, 5e-9], (0.999, 0.0005, -0.0004), (121.0, 158.0)
    words = {"a": " ".join(map(str, a)), "row": row, "column": column, "c": c, "d": d, "e": e}
    lens = load_camera(write(tmp_path / "calib_results.txt", OCAM, **words))
    u, v = np.meshgrid(np.arange(0, W, 7), np.arange(0, H, 7))
    xp, yp = np.linalg.solve(np.array([[c, d], [e, 1]]), np.stack([v.ravel() - row, u.ravel() - column]))
    zp = np.polynomial.polynomial.polyval(np.hypot(xp, yp), a)
    expected = np.stack([yp, xp, -zp], -1)  # its x is down, its y right, and it looks along -z
    expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
    np.testing.assert_allclose(lens.rays(np.stack([u.ravel(), v.ravel()], -1))[0], expected, atol=1e-9)
    covers(lens)
    half = lens.resized(W // 2, H // 2)
    np.testing.assert_allclose(half.rays([30, 40])[0], lens.rays([60.5, 80.5])[0], atol=1e-9)


def test_a_fit_says_its_largest_error(tmp_path: Path) -> None:
    w = 0.9
    path = write(tmp_path / "c.yaml", KALIBR, camera="pinhole", intrinsics=list(F), model="fov", k=[w])
    with pytest.warns(UserWarning, match=r"fitted by an equidistant lens; the largest error is 0\.\d+ px"):
        lens = load_camera(path)
    p = spread(50)
    r = np.hypot(p[..., 0], p[..., 1]) / p[..., 2]
    scale = np.arctan(2 * r * np.tan(w / 2)) / w / np.maximum(r, 1e-9)
    scale[0] = 2 * np.tan(w / 2) / w
    expected = p[..., :2] / p[..., 2:] * scale[..., None] * F[:2] + F[2:]
    assert np.abs(lens.project(p)[0] - expected).max() < 0.5


@pytest.mark.parametrize(
    ("k", "fov_deg", "degrees"),
    [
        ((0.1, -0.25, 0.1, -0.02), None, 71.9),
        ((-0.3, 0, 0, 0), None, 60.4),
        ((0, 0, -0.05, 0), None, None),
        ((0, -0.02, 0, 0), 210, None),
    ],
)
def test_a_lens_that_folds_inside_the_picture_is_refused(
    tmp_path: Path, k: tuple[float, ...], fov_deg: float | None, degrees: float | None
) -> None:
    lens = Camera("equidistant", 250, 250, 90.0, 90.0, 124.5, 124.5, k, fov_deg)
    (tmp_path / "c.json").write_text(json.dumps(lens.to_dict()))
    at = r"\d+\.\d" if degrees is None else str(degrees)
    with pytest.raises(InputError, match=rf"folds at {at} degrees from its axis: no ray reaches beyond \d+ px"):
        load_camera(tmp_path / "c.json")


def test_the_given_lenses_that_fold(cases: Path) -> None:
    for name in ("fold", "fold2"):
        with pytest.raises(InputError, match="folds at"):
            load_camera(cases / "08-lens-that-folds" / f"{name}.json")
    covers(load_camera(cases / "08-lens-that-folds" / "ok.json"))


@pytest.mark.parametrize(
    ("text", "words", "match"),
    [
        (ROS, {"W": 150, "H": 110, "model": "plumb_bob", "k": [], "n": 0}, "principal point at .* outside its picture"),
        (ROS, {"fx": 0.5, "fy": 0.5, "model": "plumb_bob", "k": [], "n": 0}, r"sees 180 degrees across"),
        (ROS, {"fx": 90000, "fy": 90000, "model": "plumb_bob", "k": [], "n": 0}, "degrees across its picture"),
        (ROS, {"fy": 20, "model": "plumb_bob", "k": [], "n": 0}, "which no square pixels give"),
        (ROS, {"model": "plumb_bob", "k": [-0.9, 0, 0, 0], "n": 4}, "not defined over its whole picture"),
        (ROS, {"model": "thin_prism", "k": [0.1], "n": 1}, "'thin_prism' in .* is not understood"),
        (ROS + "binning_x: 2\n", {"model": "plumb_bob", "k": [], "n": 0}, r"has a roi .* or binning"),
        (ROS + "roi:\n  width: 80\n", {"model": "plumb_bob", "k": [], "n": 0}, r"has a roi .* or binning"),
        (ROS, {"model": "plumb_bob", "k": ["a"], "n": 1}, "distortion_coefficients is .*expected some numbers"),
        (ROS, {"W": "wide", "model": "plumb_bob", "k": [], "n": 0}, "width and height"),
        (
            KALIBR,
            {"camera": "omni", "intrinsics": [1, *F], "model": "radtan", "k": [0.1]},
            "omni with distortion radtan",
        ),
        (KALIBR, {"camera": "pinhole", "intrinsics": [1, 2], "model": "none", "k": []}, "expected 4 numbers"),
        ("a: [\n", {}, "not readable YAML"),
        ("hello: 1\n", {}, "holds no camera that is understood"),
        ("just words\n", {}, "holds no camera"),
    ],
)
def test_lens_files_that_cannot_be_are_refused(tmp_path: Path, text: str, words: dict[str, object], match: str) -> None:
    with pytest.raises(InputError, match=match):
        load_camera(write(tmp_path / "lens.yaml", text, **words))


def test_byte_order_marks_are_taken(tmp_path: Path) -> None:
    lens = Camera("equidistant", W, H, *F)
    (tmp_path / "c.json").write_text(json.dumps(lens.to_dict()), encoding="utf-8-sig")
    assert load_camera(tmp_path / "c.json") == lens
    text = ROS.format(W=W, H=H, fx=F[0], fy=F[1], cx=F[2], cy=F[3], model="equidistant", k=[], n=0)
    (tmp_path / "c.yaml").write_text(text, encoding="utf-8-sig")
    assert load_camera(tmp_path / "c.yaml") == lens
    (tmp_path / "cameras.txt").write_text(f"1 OPENCV_FISHEYE {W} {H} 150 148 158.5 121.5 0 0 0 0", encoding="utf-8-sig")
    assert load_camera(tmp_path / "cameras.txt") == lens


def test_choices_that_a_file_leaves_open_are_asked_for(tmp_path: Path) -> None:
    path = storage(tmp_path / "lens.xml", RADTAN)
    with pytest.raises(InputError, match=r"four distortion coefficients.*camera\.model=equidistant"):
        load_camera(path)
    assert load_camera(path, model="plumb_bob").model == "rational"
    two = "1 PINHOLE {W} {H} 150 150 158 121\n2 PINHOLE {W} {H} 140 140 158 121\n"
    path = write(tmp_path / "cameras.txt", two)
    with pytest.raises(InputError, match=r"holds the cameras 1, 2; choose one with camera\.name="):
        load_camera(path)
    assert load_camera(path, name="2").fx == 140
    with pytest.raises(InputError, match="There is no camera file"):
        load_camera(tmp_path / "none.yaml")


def test_cropped_and_scaled_pictures_keep_their_rays(tmp_path: Path) -> None:
    path = write(tmp_path / "lens.yaml", ROS, model="plumb_bob", k=list(RADTAN), n=4)
    whole, part = load_camera(path), load_camera(path, crop=[40, 20, 200, 200], resize=[100, 100])
    assert (part.width, part.height) == (100, 100)
    np.testing.assert_allclose(part.rays([10, 12])[0], whole.rays([40 + 20.5, 20 + 24.5])[0], atol=1e-9)
    with pytest.raises(InputError, match="is not inside the lens's 320 x 240 px"):
        load_camera(path, crop=[200, 20, 200, 200])
    with pytest.raises(InputError, match=r"camera\.resize=\[w,h\] takes 2 whole numbers"):
        load_camera(path, resize=[100])


def test_a_lens_of_a_round_picture_need_not_be_one_in_the_corners(tmp_path: Path) -> None:
    path = write(tmp_path / "lens.yaml", ROS, model="plumb_bob", k=[-0.9, 0, 0, 0], n=4)
    with pytest.raises(InputError, match=r"not defined over its whole picture.*camera\.fov_deg="):
        load_camera(path)
    lens = load_camera(path, fov_deg=50.0)
    assert lens.fov_deg == 50 and not lens.rays([0, 0])[1] and lens.rays([158, 121])[1]


def test_a_mask_beside_the_lens_is_carried(tmp_path: Path) -> None:
    mask = np.zeros((H, W), bool)
    mask[20:220, 60:260] = True
    cv2.imwrite(str(tmp_path / "mask.png"), np.where(mask, 255, 0).astype(np.uint8))
    plain = Camera("equidistant", W, H, *F)
    (tmp_path / "c.json").write_text(json.dumps(plain.to_dict() | {"mask": "mask.png"}))
    lens = load_camera(tmp_path / "c.json")
    found = lens.mask_image()
    assert found is not None and lens.mask == mask_text(mask)
    np.testing.assert_array_equal(found, mask)
    assert not lens.pixel_rays()[1][~mask].any()
    (tmp_path / "again.json").write_text(json.dumps(lens.to_dict()))  # as a VID keeps it: without a second file
    assert load_camera(tmp_path / "again.json") == lens
    part = lens.cropped(50, 10, 100, 100).mask_image()
    assert part is not None and part[10:, 10:].all() and not part[:, :10].any()
    cv2.imwrite(str(tmp_path / "mask.png"), np.zeros((9, 9), np.uint8))
    with pytest.raises(InputError, match="mask is 9 x 9 px, the lens 320 x 240"):
        load_camera(tmp_path / "c.json")
    (tmp_path / "mask.png").unlink()
    with pytest.raises(InputError, match=r"names the mask 'mask\.png'; there is no such picture"):
        load_camera(tmp_path / "c.json")
    data = json.loads((tmp_path / "c.json").read_text())
    (tmp_path / "c.json").write_text(json.dumps(data | {"mask": 300 * "m"}))  # longer than any file's name may be
    with pytest.raises(InputError, match="names the mask 'mmm"):
        load_camera(tmp_path / "c.json")


STORED = """%YAML:1.0
---
image_width: 320
image_height: 240
{name}: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 150., {skew}, 158., 0., 148., 121., 0., 0., 1. ]
"""


@pytest.mark.parametrize(
    ("K", "reason"),
    [
        ([150, 0, 0, 0, 148, 0, 158, 121, 1], r"stands by columns, as MATLAB's do; transpose it"),
        ([150, 12, 158, 0, 148, 121, 0, 0, 1], "its pixels are skewed by 12"),
        ([150, 0, 158, 0, 148, 121, 0, 0, 0], "is no camera matrix; expected fx, 0, cx"),
        (
            [150, 0, 315, 0, 148, 121, 0, 0, 1],
            r"\(315\.0, 121\.0\), 49% of its picture .* calibration of another resolution",
        ),
    ],
)
def test_a_matrix_that_is_none_is_no_lens(tmp_path: Path, K: list[float], reason: str) -> None:
    path = tmp_path / "lens.yaml"
    path.write_text(
        f"image_width: {W}\nimage_height: {H}\ncamera_matrix: {K}\ndistortion_model: plumb_bob\n"
        "distortion_coefficients: []\n"
    )
    with pytest.raises(InputError, match=reason):
        load_camera(path)


def test_a_principal_point_far_off_the_middle_is_said(tmp_path: Path) -> None:
    (tmp_path / "c.json").write_text(json.dumps(Camera("equidistant", W, H, 150.0, 148.0, 220.0, 121.0).to_dict()))
    with pytest.warns(UserWarning, match="19% of its picture .* are row and column exchanged?"):
        load_camera(tmp_path / "c.json")


@pytest.mark.parametrize("word", ["distortion_coefficients", "dist", "D", "skew"])
def test_distortion_in_anothers_words_is_not_passed_over(tmp_path: Path, word: str) -> None:
    data = Camera("pinhole", W, H, *F).to_dict()
    (tmp_path / "c.json").write_text(json.dumps(data | {word: [-0.3, 0.1, 0, 0, 0]}))
    with pytest.raises(InputError, match=f"has {word}, which camera JSON has not: write distortion as k"):
        load_camera(tmp_path / "c.json")
    (tmp_path / "c.json").write_text(json.dumps(data | {word: 0.0, "rms_px": 0.2}))
    assert load_camera(tmp_path / "c.json").model == "pinhole"


def test_a_field_of_view_in_radians_is_told(tmp_path: Path) -> None:
    (tmp_path / "c.json").write_text(json.dumps(Camera("equidistant", W, H, *F).to_dict() | {"fov_deg": 2.79}))
    with pytest.raises(InputError, match=r"fov_deg=2\.79: it is the full angle in degrees"):
        load_camera(tmp_path / "c.json")


def test_a_circle_that_has_nothing_to_do_with_its_picture_is_said(tmp_path: Path) -> None:
    for f, fov_deg in ((179.0, 160.0), (89.5, 40.0)):
        lens = Camera("equidistant", 250, 250, f, f, 124.5, 124.5).to_dict() | {"fov_deg": fov_deg}
        (tmp_path / "c.json").write_text(json.dumps(lens))
        with pytest.warns(UserWarning, match=r"a circle \d+ px wide in its picture of 250 x 250 px"):
            load_camera(tmp_path / "c.json")


def test_a_double_sphere_with_its_numbers_exchanged_is_refused(tmp_path: Path) -> None:
    text = "cam0: {camera_model: ds, intrinsics: [0.55, -0.2, 350, 350, 320, 240], resolution: [640, 480]}\n"
    (tmp_path / "c.yaml").write_text(text)
    with pytest.raises(InputError, match=r"got 0\.55 and -0\.2; are they exchanged\?"):
        load_camera(tmp_path / "c.yaml")


def test_a_file_of_two_cameras_is_not_one(tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text(
        STORED.format(name="M1", skew=0) + STORED.format(name="M2", skew=0).partition("240\n")[2]
    )
    with pytest.raises(InputError, match="holds the two cameras M1 and M2"):
        load_camera(tmp_path / "s.yaml")
    (tmp_path / "one.yaml").write_text(STORED.format(name="camera_matrix", skew=0))
    with pytest.warns(UserWarning, match="says nothing of distortion"):
        assert load_camera(tmp_path / "one.yaml").model == "pinhole"


@pytest.mark.parametrize(("K", "D"), [("K", "D"), ("k", "d")], ids=["ROS 1", "ROS 2"])
def test_a_message_of_ros_is_taken(tmp_path: Path, K: str, D: str) -> None:
    path = tmp_path / "message.yaml"
    matrix = [150.0, 0, 158, 0, 148, 121, 0, 0, 1]
    path.write_text(f"width: {W}\nheight: {H}\n{K}: {matrix}\n{D}: {[*RADTAN, 0]}\ndistortion_model: plumb_bob\n")
    lens = load_camera(path)
    assert (lens.fx, lens.cx, lens.k[:4]) == (150, 158, RADTAN)


@pytest.mark.parametrize("text", ["{0}---\n", "{0}---\n{0}---\n"], ids=["one", "two alike"])
def test_messages_as_ros_echoes_them_are_one_lens(tmp_path: Path, text: str) -> None:
    path = write(tmp_path / "lens.yaml", ROS, model="plumb_bob", k=list(RADTAN), n=4)
    lens, message = load_camera(path), path.read_text()
    path.write_text(text.format(message))
    assert load_camera(path) == lens
    path.write_text(message + "---\n" + message.replace("150", "151"))
    with pytest.raises(InputError, match="holds 2 documents that differ"):
        load_camera(path)


@pytest.mark.parametrize(
    ("text", "words", "reason"),
    [
        (ROS, {"model": '""', "k": [0.1], "n": 1}, r"coefficients \[0\.1\] and names no model for them"),
        (KALIBR, {"camera": "pinhole", "intrinsics": list(F), "model": "none", "k": [0.1]}, "names no model for them"),
        (
            KALIBR.replace("  distortion_model: {model}\n", ""),
            {"camera": "pinhole", "intrinsics": list(F), "k": [0.1]},
            "names no model for them",
        ),
        (ROS, {"fx": 0, "fy": 0, "cx": 0, "cy": 0, "model": "plumb_bob", "k": [], "n": 0}, "it was not calibrated"),
    ],
)
def test_distortion_without_a_model_is_not_taken_for_any(
    tmp_path: Path, text: str, words: dict[str, object], reason: str
) -> None:
    with pytest.raises(InputError, match=rf"lens\.yaml .*{reason}"):
        load_camera(write(tmp_path / "lens.yaml", text, **words))


def test_a_lens_that_says_nothing_of_distortion_is_said_to_be_without(tmp_path: Path) -> None:
    text = ROS.split("distortion_model")[0]
    with pytest.warns(UserWarning, match="says nothing of distortion"):
        assert load_camera(write(tmp_path / "lens.yaml", text)).model == "pinhole"


def test_opencvs_json_is_read_and_a_number_names_a_camera(tmp_path: Path) -> None:
    path = storage(tmp_path / "lens.json", (*RADTAN, 0.01))
    np.testing.assert_allclose(load_camera(path).project(spread())[0], opencv_pixels(spread(), (*RADTAN, 0.01), False))
    two = "1 PINHOLE {W} {H} 150 150 158 121\n2 PINHOLE {W} {H} 140 140 158 121\n"
    assert load_camera(write(tmp_path / "cameras.txt", two), name=2).fx == 140  # as camera.name=2 comes
    (tmp_path / "cameras.bin").write_bytes(bytes(8))
    with pytest.raises(InputError, match=r"cameras\.bin is of a kind that is not read; write the lens as camera JSON"):
        load_camera(tmp_path / "cameras.bin")
