"""What a VID says of itself."""

from ursnav_torch.vid import Vid


def test_a_vid_and_its_kidney_print_themselves_in_one_line(vid: Vid) -> None:
    calyces = len(vid.kidney.calyces)
    assert repr(vid.kidney) == f"<Kidney of {calyces} calyces, {vid.kidney.source}>"
    lens = f"{vid.camera.model} {vid.camera.width} x {vid.camera.height}"
    assert repr(vid) == f"<Vid of {len(vid)} views of {vid.kidney!r} through {lens}>"
    assert len(repr(vid)) < 300
