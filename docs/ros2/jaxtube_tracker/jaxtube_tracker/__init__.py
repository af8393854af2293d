"""An exported jaxtube controller as a ROS 2 node."""
