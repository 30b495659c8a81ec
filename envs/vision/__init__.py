"""What cameras outside the gripper see: pictures, exact and stereo depth, point clouds. Nothing here needs a GPU."""
