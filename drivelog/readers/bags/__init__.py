"""Recordings of ROS and MCAP: containers, messages, topics and their mapping to a drive."""
