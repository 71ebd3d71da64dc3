"""Logs of drones and robots, each topic a table: ULog, ROS bags and MCAP."""
