"""`ros2 launch robot_controller robot_controller.launch.py`: the daemon, or one process a role.

Arguments, with their defaults: use_sim_time:=false, robot_name:=robot, namespace:= (that of the
robot's name), params_file:= (none), sim:=auto, single_process:=true, respawn:=false.

Ctrl-C ramps the robot down, sends a last zero and closes the recording; a process that is started
again moves nothing.
"""

from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
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
    ("single_process", "true", ("true", "false"), "false: one process a role."),
    ("respawn", "false", ("true", "false"), "Start a process again that died."),
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
    if given["single_process"] == "true":
        sim = {"auto": [], "true": ["--sim"], "false": ["--no-sim"]}[given["sim"]]
        return [_robotctl(given, "start", "--foreground", *robot, *sim)]
    auto = ["--auto"] if given["sim"] == "auto" else []
    simulated = [] if given["sim"] == "false" else [_robotctl(given, "sim", *robot, *auto)]
    owned = {"robot_name": given["robot_name"], "standalone": False}
    if given["params_file"]:
        owned["config"] = given["params_file"]
    return [
        *simulated,
        _node(given, "velocity_publisher", {"sweep": False}),
        _node(given, "odom_subscriber", {}, name="odom_logger"),
        _node(given, "mode_service", owned),
    ]


def _robotctl(given, *words):
    """Return the process of a command of robotctl."""
    executable = ExecutableInPackage(executable="robotctl", package=PACKAGE)
    return ExecuteProcess(cmd=[executable, *words], **_kept(given))


def _node(given, executable, parameters, name=None):
    """Return the process of a role; `name` is another name of its node."""
    robot, namespace = given["robot_name"], given["namespace"]
    namespace = namespace or (None if robot == "robot" else f"/{robot}")
    return Node(
        package=PACKAGE,
        executable=executable,
        name=name,
        namespace=namespace,
        parameters=[{"use_sim_time": given["use_sim_time"] == "true", **parameters}],
        **_kept(given),
    )


def _kept(given):
    """Return what every process is started with."""
    return {
        "output": "screen",
        "sigterm_timeout": SIGTERM_AFTER_S,
        "sigkill_timeout": SIGKILL_AFTER_S,
        "respawn": given["respawn"] == "true",
        "respawn_delay": 1.0,
    }
