"""What tactile scenes are composed of: a gripper with two sensors and the part that it holds."""
