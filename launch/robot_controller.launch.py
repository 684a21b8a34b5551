"""`ros2 launch robot_controller robot_controller.launch.py`: the daemon.

Its nodes bear the names of the tutorial: velocity_publisher, odom_subscriber, mode_service.

Arguments, with their defaults: use_sim_time:=false, robot_name:=robot, namespace:= (that of the
robot's name), params_file:= (none), sim:=auto, single_process:=true, respawn:=false.

Ctrl-C ramps the robot down, sends a last zero and closes the recording; a process that is started
again moves nothing.
"""

from launch.actions import DeclareLaunchArgument, ExecuteProcess, LogInfo, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.substitutions import ExecutableInPackage

from launch import LaunchDescription

PACKAGE = "robot_controller"

# (name, default, choices, description)
ARGUMENTS = (
    ("use_sim_time", "false", ("true", "false"), "Whether the nodes take their time from /clock."),
    ("robot_name", "robot", None, "The robot's name; unless it is 'robot', also its namespace."),
    ("namespace", "", None, "Another namespace than the one of the robot's name."),
    ("params_file", "", None, "Parameters: YAML, or a ROS parameter file."),
    ("sim", "auto", ("auto", "true", "false"), "auto: simulate, unless odometry is published."),
    (
        "single_process",
        "true",
        ("true", "false"),
        "Retired: names the lines of the roles.",
    ),
    ("respawn", "false", ("true", "false"), "Start a process again that died."),
)

RETIRED = (
    "single_process:=false is retired: the daemon starts. The tutorial's nodes, one a process, are "
    "ros2 run robot_controller velocity_publisher, ros2 run robot_controller odom_subscriber and "
    "ros2 run robot_controller mode_service"
)

# Longer than the ramp, the last zero and the end of the recording take.
SIGTERM_AFTER_S = "10"
SIGKILL_AFTER_S = "10"


def generate_launch_description():
    """Return the launch description."""
    declared = [
        DeclareLaunchArgument(
            name,
            default_value=default,
            description=description,
            **({"choices": list(choices)} if choices else {}),
        )
        for name, default, choices, description in ARGUMENTS
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=processes)])


def processes(context):
    """Return the processes for the arguments of this launch."""
    given = {name: LaunchConfiguration(name).perform(context) for name, *_ in ARGUMENTS}
    robot = ["--robot", given["robot_name"]]
    if given["namespace"]:
        robot += ["--namespace", given["namespace"]]
    if given["params_file"]:
        robot += ["--config", given["params_file"]]
    ros = []
    if given["use_sim_time"] == "true":
        ros = ["--ros-args", "-p", "use_sim_time:=true"]
    sim = {"auto": [], "true": ["--sim"], "false": ["--no-sim"]}[given["sim"]]
    daemon = ExecuteProcess(
        cmd=[
            ExecutableInPackage(executable="robotctl", package=PACKAGE),
            *("start", "--foreground", *robot, *sim, *ros),
        ],
        output="screen",
        sigterm_timeout=SIGTERM_AFTER_S,
        sigkill_timeout=SIGKILL_AFTER_S,
        respawn=given["respawn"] == "true",
        respawn_delay=1.0,
    )
    return [daemon] if given["single_process"] == "true" else [LogInfo(msg=RETIRED), daemon]
