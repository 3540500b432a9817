"""The physics of the load, the sled and the standard. No ROS, no rendering, no learning."""
