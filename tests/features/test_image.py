from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from ursnav_torch.camera import equidistant_camera
from ursnav_torch.errors import InputError
from ursnav_torch.features import check_image, read_image
from ursnav_torch.features.image import signal

RNG = np.random.default_rng(0)
GRAY = RNG.integers(0, 256, (40, 60), np.uint8)
COLOR = RNG.integers(0, 256, (40, 60, 3), np.uint8)


@pytest.mark.parametrize("name", ["x.png", "X.PNG", "x.bmp", "x.tif", "ö [1], a=b.png"])
@pytest.mark.parametrize("image", [GRAY, COLOR], ids=["gray", "color"])
def test_pictures_come_as_they_were_written(tmp_path: Path, name: str, image: np.ndarray) -> None:
    path = tmp_path / name
    path.write_bytes(cv2.imencode(path.suffix.lower(), image)[1].tobytes())
    np.testing.assert_array_equal(read_image(path), image)


def test_transparency_is_dropped_and_depth_scaled(tmp_path: Path) -> None:
    path = tmp_path / "x.png"
    cv2.imwrite(str(path), np.dstack([COLOR, GRAY]))
    np.testing.assert_array_equal(read_image(path), COLOR)
    for top in (1023, 65535):
        cv2.imwrite(str(path), (GRAY / 255 * top).round().astype(np.uint16))
        got = read_image(path).astype(int)
        assert np.abs(got - np.round(GRAY * (255 / GRAY.max()))).max() <= 1, "the picture's own maximum becomes 255"


@pytest.mark.parametrize("suffix", ["png", "jpg"])
def test_a_picture_cut_short_is_never_filled_in(tmp_path: Path, suffix: str) -> None:
    """OpenCV gives a JPEG that lacks its end as if it were whole, the rest gray."""
    path = tmp_path / f"x.{suffix}"
    cv2.imwrite(str(path), COLOR)
    whole = path.read_bytes()
    for size in (len(whole) - 13, len(whole) // 2, 9):
        path.write_bytes(whole[:size])
        with pytest.raises(InputError, match=rf"x\.{suffix} is cut short \({size} bytes"):
            read_image(path)
    for more in (b"trailing", b"x" * 1000, b"\0\0\0\x18ftypmp42" + bytes(5000)):  # as phones append a video
        path.write_bytes(whole + more)
        assert read_image(path).shape == COLOR.shape
    path.write_bytes(whole[: len(whole) // 2] + bytes(len(whole) // 2))
    with pytest.raises(InputError, match="cut short"):
        read_image(path)


def test_the_end_of_a_thumbnail_is_not_the_pictures(tmp_path: Path) -> None:
    whole = cv2.imencode(".jpg", COLOR)[1].tobytes()
    inner = b"\xff\xd8\xff\xd9"
    held = whole[:2] + b"\xff\xe1" + (len(inner) + 2).to_bytes(2) + inner + whole[2:]
    (tmp_path / "x.jpg").write_bytes(held)
    assert read_image(tmp_path / "x.jpg").shape == COLOR.shape
    (tmp_path / "x.jpg").write_bytes(held[:-200])
    with pytest.raises(InputError, match="cut short"):
        read_image(tmp_path / "x.jpg")


@pytest.mark.parametrize(("kind", "suffix"), [("MPO", "jpg"), ("PNG", "png")])
def test_several_pictures_in_a_jpeg_or_png_are_refused_with_their_number(
    tmp_path: Path, kind: str, suffix: str
) -> None:
    from PIL import Image

    first = Image.fromarray(COLOR)
    first.save(tmp_path / f"x.{suffix}", kind, save_all=True, append_images=[first.rotate(180)])
    with pytest.raises(InputError, match=rf"x\.{suffix} holds 2 pictures"):
        read_image(tmp_path / f"x.{suffix}")


@pytest.mark.parametrize(
    "image", [GRAY.astype(np.float32), GRAY[None, None], "x.png", np.zeros((40, 60, 2, 1), np.uint8)]
)
def test_refuses_arrays_that_are_no_pictures(image: object) -> None:
    with pytest.raises(InputError, match="must be a uint8 array"):
        check_image(image, equidistant_camera(160, 60, 40))  # type: ignore[arg-type]


def test_refuses_another_size_and_says_both() -> None:
    with pytest.raises(InputError, match="60 x 40 px, but the lens is 40 x 60 px"):
        check_image(GRAY, equidistant_camera(160, 40, 60))


def test_gray_in_color_is_gray_and_red_prevails_in_red() -> None:
    same = signal(np.dstack([GRAY] * 3))
    torch.testing.assert_close(same, torch.from_numpy(GRAY).float(), rtol=1e-4, atol=1e-3)
    red = np.dstack([GRAY // 16, GRAY // 8, GRAY])
    assert np.corrcoef(signal(red).numpy().ravel(), GRAY.ravel())[0, 1] > 0.999


def test_channels_count_by_the_square_of_their_means() -> None:
    """Their share of shot-noise-limited signal: channels of means 1, 2 and 4 count 1, 4 and 16."""
    ones = np.ones((30, 30), np.uint8)
    mixed = np.dstack([10 * ones, 20 * ones, 40 * ones])
    mixed[::2, :, 0], mixed[1::2, :, 0] = 0, 20  # one channel varies
    spread = signal(mixed)
    torch.testing.assert_close(spread[0, 0] - spread[1, 0], torch.tensor(-20 / 21), rtol=1e-3, atol=1e-4)
    torch.testing.assert_close(spread.mean(), torch.tensor((10 + 80 + 640) / 21), rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("turn", [1, 3, 6, 8])
def test_pictures_are_turned_as_their_exif_data_say(tmp_path: Path, turn: int) -> None:
    from PIL import Image, ImageOps

    picture = Image.fromarray(np.repeat(np.repeat(np.arange(12, dtype=np.uint8).reshape(3, 4) * 20, 8, 0), 8, 1))
    exif = Image.Exif()
    exif[0x0112] = turn
    for name in ("a.png", "b.png"):
        picture.save(tmp_path / name, exif=exif)
        expected = np.asarray(ImageOps.exif_transpose(Image.open(tmp_path / name)))
        np.testing.assert_array_equal(read_image(tmp_path / name), expected)
    picture.save(tmp_path / "a.jpg", exif=exif, quality=95)
    assert read_image(tmp_path / "a.jpg").shape == expected.shape


@pytest.mark.parametrize("pages", [2, 3, 7])
def test_a_file_with_several_pictures_is_refused_with_their_number(tmp_path: Path, pages: int) -> None:
    from PIL import Image

    sheets = [Image.fromarray(np.full((20, 30), 10 * n, np.uint8)) for n in range(pages)]
    sheets[0].save(tmp_path / "stack.tif", save_all=True, append_images=sheets[1:])
    with pytest.raises(InputError, match=rf"stack\.tif holds {pages} pictures \(pages\) in one file"):
        read_image(tmp_path / "stack.tif")
    sheets[0].save(tmp_path / "one.tif")
    assert read_image(tmp_path / "one.tif").shape == (20, 30)


@pytest.mark.parametrize(
    ("data", "what"),
    [(b"", "empty"), (b"GIF89a..", "a GIF"), (b"RIFF....WEBPVP8 ", "a WebP"), (bytes(128) + b"DICM", "a DICOM file")],
)
def test_files_that_are_no_such_pictures_are_named_as_what_they_are(tmp_path: Path, data: bytes, what: str) -> None:
    (tmp_path / "x.png").write_bytes(data)
    with pytest.raises(InputError, match=rf"x\.png is {what} by its bytes and not a readable picture"):
        read_image(tmp_path / "x.png")


def test_the_given_stack_is_refused(cases: Path) -> None:
    with pytest.raises(InputError, match="holds 3 pictures"):
        read_image(cases / "17-tiff-stack" / "15_stack.tif")
