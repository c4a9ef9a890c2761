"""The runner ``match``: what users give it, good and bad, and what they get."""

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from ursnav_torch.camera import equidistant_camera, mask_text
from ursnav_torch.columns import MATCH_COLUMNS
from ursnav_torch.errors import InputError
from ursnav_torch.matching import Hungarian, Nearest, Sinkhorn
from ursnav_torch.runs.pictures import find_images
from ursnav_torch.vid import Vid

AWKWARD = "Bilder, [Niere] a=b {1} ä ö 'ß'"


def read(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture
def images(tmp_path: Path, picture: np.ndarray) -> Path:
    folder = tmp_path / "images"
    folder.mkdir()
    cv2.imwrite(str(folder / "good.png"), picture)
    return folder


@pytest.fixture
def bad_images(images: Path, picture: np.ndarray) -> Path:
    """One good picture, each kind of bad one, and files that are no pictures."""

    def put(name: str, image: np.ndarray) -> bytes:
        ok, data = cv2.imencode(Path(name).suffix, image)
        assert ok
        (images / name).write_bytes(data.tobytes())
        return data.tobytes()

    for suffix in ("png", "jpg", "bmp", "tif"):
        whole = put(f"cut.{suffix}", picture)
        (images / f"cut.{suffix}").write_bytes(whole[: len(whole) * 2 // 3])
    put("one.png", np.zeros((1, 1), np.uint8))
    put("wider.png", np.kron(picture, np.ones((1, 2), np.uint8)))
    put("black.png", np.zeros_like(picture))
    put("white.png", np.full_like(picture, 255))
    put("depth16.png", picture.astype(np.uint16) * 200)
    put("depth16.TIF", picture.astype(np.uint16) * 16)
    put("rgba.png", np.dstack([picture] * 3 + [np.full_like(picture, 77)]))
    put("floats.tiff", picture.astype(np.float32) / 255)
    put("holes.tiff", np.where(picture > 100, np.nan, picture).astype(np.float32))
    (images / "nothing.png").touch()
    (images / "text.jpg").write_text("no picture")
    (images / "gone.png").symlink_to("nowhere")
    (images / "folder.png").mkdir()
    (images / "notes.txt").touch()
    return images


def test_every_picture_has_its_row_whatever_the_others_are(run: Any, vid: Vid, bad_images: Path) -> None:
    done = run("match", f"vid={vid.folder}", f"images={bad_images}", "out=rows.csv", "report=pages")
    assert done.code == 3 and done.err == ""
    rows = {row["image"]: row for row in read(Path("rows.csv"))}
    assert done.out.startswith("17 pictures: ") and "12 with an error" in done.out
    for name, says in {
        "black.png": "all black", "white.png": "all white", "one.png": r"1 x 1 px, but the lens is 96 x 96",
        "wider.png": "192 x 96 px, but the lens is 96 x 96 px; no one ratio",
        "nothing.png": "not a readable picture", "text.jpg": "not a readable picture",
        "cut.png": "cut short", "cut.jpg": "cut short", "cut.bmp": "cut.bmp", "cut.tif": "cut.tif",
        "holes.tiff": "not finite", "gone.png": "There is no image",
    }.items():  # fmt: skip
        assert says in rows[name]["error"], (name, rows[name])
        assert all(rows[name][key] == "" for key in MATCH_COLUMNS if key not in ("image", "error"))
    for name in ("rgba.png", "depth16.png", "depth16.TIF", "floats.tiff"):
        same = {k: v for k, v in rows["good.png"].items() if k not in ("image", "seconds")}
        assert same["error"] == "" and same["view"] == "3"
        for key in ("calyx", "view", "error"):
            assert rows[name][key] == same[key]
        assert abs(float(rows[name]["x_mm"]) - float(same["x_mm"])) < 0.2
    assert Path("pages/index.html").exists()


def test_rows_are_as_the_contract_says(run: Any, vid: Vid, images: Path, picture: np.ndarray) -> None:
    for name in ("view10.png", "view2.PNG", "sub/view1.jpeg", "zß.bmp"):
        (images / name).parent.mkdir(exist_ok=True)
        (images / name).write_bytes(cv2.imencode(".png", picture)[1].tobytes())
    done = run("match", f"vid={vid.folder}", f"images={images}", "out=new folder/rows.csv")
    assert (done.code, done.err) == (0, "") and done.out.startswith("5 pictures")
    path = Path("new folder/rows.csv")
    assert path.read_text(encoding="utf-8").splitlines()[0] == (
        "image,calyx,x_mm,y_mm,z_mm,qx,qy,qz,qw,view,distance,confidence,accepted,seconds,error,"
        "calyces,position_sd_mm,direction_sd_deg"
    )
    rows = read(path)
    assert [row["image"] for row in rows] == ["good.png", "sub/view1.jpeg", "view2.PNG", "view10.png", "zß.bmp"]
    row = rows[0]
    assert row["accepted"] in ("true", "false") and 0 <= float(row["confidence"]) <= 1 and float(row["seconds"]) > 0
    assert np.linalg.norm([float(row[k]) for k in ("qx", "qy", "qz", "qw")]) == pytest.approx(1, abs=1e-5)
    assert row["calyx"] == vid.calyx_name(int(vid.calyx[3])) == row["calyces"].split("|")[0]
    assert float(row["position_sd_mm"]) > 0 and 0 < float(row["direction_sd_deg"]) <= 180
    assert [p.name for p in Path().iterdir()] == ["new folder"], "nothing else is written in the caller's folder"


def test_one_file_one_glob_and_relative_paths(run: Any, vid: Vid, images: Path, picture: np.ndarray) -> None:
    for name in ("a1.png", "a2.png", "b.png"):
        cv2.imwrite(str(images / name), picture)
    shutil.copytree(images, images.parent / "caller's folder" / "near")
    for where, expected in (
        (f"{images}/b.png", ["b.png"]), ("near/a?.png", ["a1.png", "a2.png"]),
        (f"{images.parent}/**/b.png", ["caller's folder/near/b.png", "images/b.png"]),
    ):  # fmt: skip
        assert run("match", f"vid={vid.folder}", f"images={where}", "out=x.csv", "overwrite=true").code == 0
        assert [row["image"] for row in read(Path("x.csv"))] == expected


def test_awkward_paths(run: Any, vid: Vid, images: Path) -> None:
    base = images.parent / AWKWARD
    shutil.copytree(vid.folder, base / "vid")
    shutil.copytree(images, base / "images [x]")
    done = run("match", f"vid={base}/vid", f"images={base}/images [x]", f"out={base}/r,=.csv", f"report={base}/p")
    assert (done.code, done.err) == (0, "")
    assert len(read(base / "r,=.csv")) == 1 and (base / "p" / "index.html").exists()


def test_an_out_that_looks_like_a_number_is_a_path(run: Any, vid: Vid, images: Path) -> None:
    assert run("match", f"vid={vid.folder}", f"images={images}", "out=2026").code == 0
    assert len(read(Path("2026"))) == 1


@pytest.mark.parametrize(
    ("images", "says"),
    [
        ("nowhere.png", "There is no picture at"),
        ("nowhere/*.png", "There is no picture at"),
        ("empty", "holds no picture"),
        ("texts", "holds no picture"),
        ("texts/a.txt", "not a readable picture"),
    ],
)
def test_nothing_to_match(run: Any, vid: Vid, tmp_path: Path, images: str, says: str) -> None:
    work = tmp_path / "caller's folder"
    (work / "empty").mkdir()
    (work / "texts").mkdir()
    (work / "texts" / "a.txt").write_text("x")
    done = run("match", f"vid={vid.folder}", f"images={images}", "out=x.csv")
    if done.code == 3:  # a file given by name is tried
        assert says in read(Path("x.csv"))[0]["error"]
    else:
        assert done.code == 1 and says in done.err and done.err.startswith("error: ") and done.err.count("\n") == 1
        assert not Path("x.csv").exists() and done.out == ""


def test_results_are_not_replaced_unasked(run: Any, vid: Vid, images: Path, tmp_path: Path) -> None:
    work = tmp_path / "caller's folder"
    (work / "mine.csv").write_text("mine")
    (work / "page").mkdir()
    (work / "page" / "index.html").write_text("mine")
    (work / "empty").mkdir()
    given = ("match", f"vid={vid.folder}", f"images={images}")
    for overrides, says in (
        (("out=mine.csv",), "exists already"), (("out=new.csv", "report=page"), "exists already"),
        (("out=page", "overwrite=true"), "is a folder"), (("out=mine.csv/x.csv",), "cannot be made"),
    ):  # fmt: skip
        done = run(*given, *overrides)
        assert done.code == 1 and says in done.err and done.err.count("\n") == 1
        assert (
            (work / "mine.csv").read_text(encoding="utf-8")
            == (work / "page" / "index.html").read_text(encoding="utf-8")
            == "mine"
        )
    assert sorted(p.name for p in work.iterdir()) == ["empty", "mine.csv", "page"]
    assert run(*given, "out=mine.csv", "report=empty", "overwrite=true").code == 0
    assert len(read(work / "mine.csv")) == 1 and (work / "empty" / "index.html").exists()
    assert not list(work.rglob("*.partial"))


def edited(folder: Path) -> None:
    path = folder / "vid.json"
    data = json.loads(path.read_text(encoding="utf-8"))
    data["camera"]["fx"] += 1
    path.write_text(json.dumps(data), encoding="utf-8")


def truncated(folder: Path) -> None:
    path = folder / "features.safetensors"
    path.write_bytes(path.read_bytes()[:-1000])


def moved_view(folder: Path) -> None:
    path = folder / "views.csv"
    path.write_text(path.read_text(encoding="utf-8").replace("0,A,", "0,B,"), encoding="utf-8")


BROKEN = {
    "no vid.json": (lambda f: (f / "vid.json").unlink(), "not a finished VID"),
    "empty vid.json": (lambda f: (f / "vid.json").write_text(""), "not the description of a VID"),
    "a list for vid.json": (lambda f: (f / "vid.json").write_text("[1]"), "not the description of a VID"),
    "vid.json edited": (edited, "was changed after the VID was built"),
    "no kidney": (lambda f: (f / "kidney.stl").unlink(), "lacks kidney.stl"),
    "no features": (lambda f: (f / "features.safetensors").unlink(), "lacks features.safetensors"),
    "features cut short": (truncated, "features.safetensors"),
    "views edited": (moved_view, "was changed after the VID was built"),
    "a calyx renamed": (lambda f: (f / "calyces.csv").write_text("calyx,x_mm,y_mm,z_mm\nZ,0,0,0\n"), "was changed"),
}


@pytest.mark.parametrize("what", BROKEN)
def test_a_damaged_vid_is_refused_in_one_line(run: Any, vid: Vid, images: Path, what: str) -> None:
    damage, says = BROKEN[what]
    folder = images.parent / "vid"
    shutil.copytree(vid.folder, folder)
    damage(folder)
    done = run("match", f"vid={folder}", f"images={images}", "out=x.csv")
    assert done.code == 1 and says in done.err and done.err.startswith("error: ") and done.err.count("\n") == 1
    assert not list(Path().iterdir())


def test_a_vid_without_its_pictures_still_matches(run: Any, vid: Vid, images: Path) -> None:
    folder = images.parent / "vid"
    shutil.copytree(vid.folder, folder, ignore=shutil.ignore_patterns("images"))
    done = run("match", f"vid={folder}", f"images={images}", "out=x.csv", "report=page")
    assert done.code == 1 and "has no pictures" in done.err and not list(Path().iterdir())
    assert run("match", f"vid={folder}", f"images={images}", "out=x.csv").code == 0


def test_no_vid(run: Any, vid: Vid, images: Path) -> None:
    shutil.copytree(vid.folder, images.parent / "x.partial")
    for where, says in (
        ("nowhere", "There is no VID folder"), (f"{images}/good.png", "not the description of a VID"),
        (str(images), "not a finished VID"), (f"{images.parent}/x.partial", "not a finished VID"),
    ):  # fmt: skip
        done = run("match", f"vid={where}", f"images={images}", "out=x.csv")
        assert done.code == 1 and says in done.err and done.err.count("\n") == 1
    assert run("match", f"images={images}", "out=x.csv").code == 2


@pytest.mark.slow
def test_pictures_of_another_lens_are_refused(run: Any, vid: Vid, images: Path) -> None:
    given = ("match", f"vid={vid.folder}", f"images={images}", "out=x.csv")
    lens = images.parent / "lens, ä=1.json"
    lens.write_text(json.dumps(equidistant_camera(140, 96, 96).to_dict()))
    for overrides in (
        ("camera=equidistant", "camera.fov_deg=140", "camera.width=96", "camera.height=96"),
        ("camera=equidistant",), ("camera=pinhole", "camera.width=96", "camera.height=96"),
        ("camera=file", f"camera.path={lens}"),
    ):  # fmt: skip
        done = run(*given, *overrides)
        assert done.code == 1 and "build a VID with camera=" in done.err and not Path("x.csv").exists()
    lens.write_text(json.dumps(vid.camera.to_dict()))
    assert run(*given, "camera=file", f"camera.path={lens}").code == 0


@pytest.mark.parametrize(
    ("choice", "method"),
    [("matching=nearest", Nearest), ("matching=sinkhorn", Sinkhorn), ("matching=hungarian", Hungarian),
     ("localization=edges", Nearest)],
)  # fmt: skip
def test_every_way_of_matching_does_its_work_and_knows_a_view_again(
    run: Any, vid: Vid, images: Path, choice: str, method: type, monkeypatch: pytest.MonkeyPatch
) -> None:
    solved: dict[str, int] = {}
    for each in (Nearest, Sinkhorn, Hungarian):

        def counted(self: Any, *given: Any, assign: Any = each.assign, name: str = each.__name__) -> Any:
            solved[name] = solved.get(name, 0) + 1
            return assign(self, *given)

        monkeypatch.setattr(each, "assign", counted)
    assert run("match", f"vid={vid.folder}", f"images={images}", "out=x.csv", choice).code == 0
    rows = read(Path("x.csv"))
    assert rows[0]["view"] == "3"
    assert solved == {method.__name__: sum(bool(row["view"]) for row in rows)}  # one batch of finalists a picture


def test_natural_order_and_other_files(tmp_path: Path) -> None:
    for name in ("10.png", "9.png", "B.PNG", "a.jpg", "a.csv", "Thumbs.db"):
        (tmp_path / name).touch()
    base, found = find_images(str(tmp_path))
    assert base == tmp_path and [p.name for p in found] == ["9.png", "10.png", "a.jpg", "B.PNG"]
    with pytest.raises(InputError, match=r"\.png, \.jpg"):
        find_images(str(tmp_path / "*.csv"))


def test_pictures_scaled_by_one_ratio_are_taken_and_it_is_said(run: Any, vid: Vid, images: Path) -> None:
    picture = cv2.imread(str(images / "good.png"), cv2.IMREAD_UNCHANGED)
    cv2.imwrite(str(images / "twice.png"), cv2.resize(picture, (192, 192), interpolation=cv2.INTER_CUBIC))
    with pytest.warns(UserWarning, match="192 x 192 px are taken for the lens's 96 x 96 px, scaled by 2"):
        done = run("match", f"vid={vid.folder}", f"images={images}", "out=rows.csv")
    assert done.code == 0
    good, twice = read(Path("rows.csv"))
    assert twice["calyx"] == good["calyx"]
    assert all(abs(float(twice[c]) - float(good[c])) < 1.0 for c in ("x_mm", "y_mm", "z_mm"))


def test_cropped_pictures_are_taken_where_the_cut_is_said(run: Any, vid: Vid, images: Path) -> None:
    given = images.parent / "lens.json"
    given.write_text(json.dumps(vid.camera.to_dict()), encoding="utf-8")
    picture = cv2.imread(str(images / "good.png"), cv2.IMREAD_UNCHANGED)
    (images / "cut").mkdir()
    cv2.imwrite(str(images / "cut" / "a.png"), cv2.resize(picture[6:90, 8:92], (168, 168)))
    lens = ["camera=file", f"camera.path={given}", "camera.crop=[8,6,84,84]", "camera.resize=[168,168]"]
    done = run("match", f"vid={vid.folder}", f"images={images / 'cut'}", "out=cut.csv", *lens)
    assert (done.code, done.err) == (0, "")
    assert run("match", f"vid={vid.folder}", f"images={images / 'good.png'}", "out=good.csv").code == 0
    (cut,), (good,) = read(Path("cut.csv")), read(Path("good.csv"))
    assert cut["calyx"] == good["calyx"]
    assert all(abs(float(cut[c]) - float(good[c])) < 2.0 for c in ("x_mm", "y_mm", "z_mm"))
    other = run("match", f"vid={vid.folder}", f"images={images}", "out=x.csv", *lens[:2], "camera.crop=[0,0,200,84]")
    assert other.code == 1 and "is not inside the lens's 96 x 96 px" in other.err


def test_what_lies_outside_the_stated_mask_is_nothing_to_the_answer(run: Any, vid: Vid, images: Path) -> None:
    """The calibration's mask is narrower than the VID's lens; the pictures are as large as the lens's."""
    picture, mask = cv2.imread(str(images / "good.png"), cv2.IMREAD_UNCHANGED), np.zeros((96, 96), bool)
    mask[:, :64] = True
    other = np.where(mask, picture, np.random.default_rng(0).integers(0, 256, mask.shape)).astype(np.uint8)
    cv2.imwrite(str(images / "other.png"), other)
    lens = images.parent / "lens.json"
    lens.write_text(json.dumps(replace(vid.camera, mask=mask_text(mask)).to_dict()), encoding="utf-8")
    stated = ("camera=file", f"camera.path={lens}")
    assert run("match", f"vid={vid.folder}", f"images={images}", "out=rows.csv", *stated).code == 0
    good, same = ({k: v for k, v in row.items() if k not in ("image", "seconds")} for row in read(Path("rows.csv")))
    assert good == same and good["x_mm"]
