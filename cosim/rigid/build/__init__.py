"""The rigid scene's model: arm, objects, joints and wires, compiled by MuJoCo."""
