"""Send a motion that `cosim export-path` wrote to a robot with ROS 2, pressures and tensions at their times.

    python publish_motion.py way.yaml way.csv

The trajectory goes to the joints' controller once. What the soft robot is asked for goes out row by row, as
an array in the order of the columns that it prints. Needs rclpy, of a ROS 2 installation.
"""

import csv
import sys
import time

import rclpy
import yaml
from rclpy.node import Node
from rosidl_runtime_py import set_message_fields
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

CONTROLLER = "/scaled_joint_trajectory_controller/joint_trajectory"
SOFT_ROBOT = "/soft_robot/command"
UNITS = (".pressure_Pa", ".tension_N", ".length_m")


def main(trajectory_file: str, table_file: str) -> None:
    """Send both."""
    with open(trajectory_file, encoding="utf-8") as file:
        trajectory = JointTrajectory()
        set_message_fields(trajectory, yaml.safe_load(file))
    with open(table_file, encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    columns = [name for name in rows[0] if name.endswith(UNITS)]
    rclpy.init()
    node = Node("cosim_motion")
    joints = node.create_publisher(JointTrajectory, CONTROLLER, 1)
    soft = node.create_publisher(Float64MultiArray, SOFT_ROBOT, 10)
    while not joints.get_subscription_count():
        time.sleep(0.1)
    print("columns:", ", ".join(columns))
    joints.publish(trajectory)
    began = time.monotonic()
    for row in rows:
        time.sleep(max(began + float(row["time_s"]) - time.monotonic(), 0.0))
        soft.publish(Float64MultiArray(data=[float(row[name]) for name in columns]))
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main(*sys.argv[1:3])
