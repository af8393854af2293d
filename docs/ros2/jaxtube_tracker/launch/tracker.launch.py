"""Start the node with the parameters of config/tracker.yaml and the folder of a controller."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description():
    """Return the launch description."""
    parameters = PathJoinSubstitution(
        [FindPackageShare("jaxtube_tracker"), "config", "tracker.yaml"]
    )
    folder = {"controller_folder": LaunchConfiguration("controller_folder")}
    return LaunchDescription(
        [
            DeclareLaunchArgument("controller_folder", description="what `export` has written"),
            Node(
                package="jaxtube_tracker",
                executable="tracker",
                parameters=[parameters, folder],
                output="screen",
            ),
        ]
    )
