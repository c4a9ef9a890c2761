"""How far answers are from the truth: errors of poses and tracks."""

from ursnav_torch.evaluation.metrics import (
    PoseErrors,
    frames_to_loss,
    jitter_mm,
    pose_errors,
    success,
    trajectory_error_mm,
    write_tum,
)

__all__ = ["PoseErrors", "frames_to_loss", "jitter_mm", "pose_errors", "success", "trajectory_error_mm", "write_tum"]
