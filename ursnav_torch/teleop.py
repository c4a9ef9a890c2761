"""Drive the scope: gamepad to robot and light, recorded if wanted; or a recorded session again."""

from typing import Any

from ursnav_torch._runner import runner

PATHS = (
    "hardware.path",
    "hardware.camera.folder",
    "hardware.camera.path",
    "hardware.camera.calibration",
    "hardware.tracker.path",
    "hardware.gamepad.path",
)


@runner("teleop", paths=PATHS)
def main(config: Any) -> None:
    """Instantiate the choices and run a session without navigation."""
    from hydra.utils import instantiate
    from omegaconf import OmegaConf

    from ursnav_torch.session import StatusLine, open_session
    from ursnav_torch.simulation import World

    def world() -> World:
        kidney = instantiate(config.kidney)
        return World(kidney, instantiate(config.rendering)(kidney.mesh, instantiate(config.camera)))

    plain = OmegaConf.to_container(config, resolve=True)
    recorder = instantiate(config.session)(config=plain) if config.session else None
    status = StatusLine()
    with open_session(instantiate(config.hardware), world, recorder, config.duration_s) as session:
        summary = session.run(None, status)
    status.close()
    print(summary.text() + (f"; record in {config.out}" if recorder else ""))


if __name__ == "__main__":
    main()
