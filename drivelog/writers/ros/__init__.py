"""ROS 2 messages without ROS: their types, how they are made, and MCAP files that hold them."""
