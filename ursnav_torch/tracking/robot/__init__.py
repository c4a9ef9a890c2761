"""What a robot's joints tell of the camera: odometry behind plays, the shaft's way in, and dead reckoning by both."""
