"""The arm's kinematics and dynamics in closed form, by Pinocchio."""
