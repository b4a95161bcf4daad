"""A robot that speaks ROS 2 by `rmw_zenoh`, without any ROS here (sim/README.md, "A ROS 2 robot")."""
