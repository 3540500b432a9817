"""Between sim_core's records and ROS messages: topic names, QoS, frames and conversions."""
