"""Read logs of drones and robots (ULog, ROS bags and MCAP); each topic is a table."""
