"""The challenge's ROS topics and service: what its tracker publishes, from our cameras and tracker."""
