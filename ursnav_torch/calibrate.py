"""Calibrate the scope's camera from pictures of a printed board, and print the board."""

from typing import Any

from ursnav_torch._runner import caller_path, runner


@runner("calibrate", paths=("images", "print_board"))
def main(config: Any) -> None:
    """Compose the board and call `calibration.calibrate_camera` or `calibration.save_board`."""
    from ursnav_torch.calibration import (
        Board,
        calibrate_camera,
        calibration_files,
        save_board,
        save_calibration,
        summary,
    )

    printed = config.square_mm, config.marker_mm, str(config.dictionary), config.column_mm
    board = Board(config.board, config.columns, config.rows, *printed)
    if config.print_board:
        save_board(board, caller_path(config.print_board), config.overwrite)
        print(f"{config.print_board}: print it at 100 %, then measure a square: that is square_mm.")
        return

    from ursnav_torch.features import read_image
    from ursnav_torch.results import check_set
    from ursnav_torch.runs.pictures import find_images

    out = caller_path(config.out)
    check_set(calibration_files(out), config.overwrite)
    base, paths = find_images(str(caller_path(config.images)))
    result = calibrate_camera(
        {path.relative_to(base).as_posix(): read_image(path) for path in paths}, board, config.model
    )
    save_calibration(result, out, config.overwrite)
    print(summary(result))


if __name__ == "__main__":
    main()
