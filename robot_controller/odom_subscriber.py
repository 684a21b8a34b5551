"""OdomSubscriber, the node of `python -m robot_controller.odom_subscriber`."""

from robotctl import environment

if __name__ == "__main__":
    environment.prepare()  # before rclpy is imported

from robotctl.ros.executables.odom_subscriber import OdomSubscriber, main

__all__ = ["OdomSubscriber", "main"]

if __name__ == "__main__":
    raise SystemExit(main())
