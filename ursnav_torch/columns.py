"""The header of every CSV file that is read or written, once (design: file formats)."""

#: A pose ``T_kidney_camera``: position in mm, quaternion x, y, z, w.
POSE_COLUMNS = ("x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw")
#: The views of a VID.
VIEW_COLUMNS = ("view", "calyx", *POSE_COLUMNS)
#: Poses as the thesis's Unity scene wrote them: left-handed, meters.
UNITY_COLUMNS = ("x_unity", "y_unity", "z_unity", "qx", "qy", "qz", "qw")
#: How sure an answer is: the calyces it may be, names joined by ``|``, and what two of three errors are within.
SURE_COLUMNS = ("calyces", "position_sd_mm", "direction_sd_deg")
#: What `match` writes.
MATCH_COLUMNS = (
    *("image", "calyx", *POSE_COLUMNS, "view", "distance", "confidence", "accepted", "seconds", "error"),
    *SURE_COLUMNS,
)
#: What `track` writes.
TRACK_COLUMNS = ("frame", "t_s", "calyx", *POSE_COLUMNS, "confidence", "state", "seconds", *SURE_COLUMNS)
#: What a robot reports of its joints, slack and hysteresis included.
ODOMETRY_COLUMNS = ("t_s", "insertion_mm", "bend_x_deg", "bend_y_deg")
#: True poses of pictures.
TRUTH_COLUMNS = ("image", "calyx", *POSE_COLUMNS)
#: An EM sensor's position and axis in the EM frame; ``frame`` or ``image`` and ``t_s`` stand before them where known.
EM_COLUMNS = ("x_mm", "y_mm", "z_mm", "dx", "dy", "dz")
#: Landmarks in both frames.
LANDMARK_COLUMNS = ("kidney_x_mm", "kidney_y_mm", "kidney_z_mm", "em_x_mm", "em_y_mm", "em_z_mm")
#: Stones known before, from a scan: place of the middle and longest diameter.
KNOWN_STONE_COLUMNS = ("stone", "x_mm", "y_mm", "z_mm", "size_mm")
#: Stones that `track` and `navigate` saw: ``known`` names the stone of the scan that it is, ``state`` is ``there``,
#: ``gone`` or ``not found``, ``frame`` the picture that shows it best.
STONE_COLUMNS = (
    *("stone", "calyx", "x_mm", "y_mm", "z_mm", "size_mm", "pictures", "confidence"),
    *("size_sd_mm", "position_sd_mm", "state", "known", "frame"),
)
