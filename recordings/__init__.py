"""MCAP bags as rosbag2 writes them: the only place that knows the container's format."""
