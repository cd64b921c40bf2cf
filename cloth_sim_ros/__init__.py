"""ROS 2 side of the cloth simulator: messages in, markers and MCAP logs out. Only `node` and `play` import rclpy."""
