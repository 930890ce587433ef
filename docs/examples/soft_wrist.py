"""A tool hangs on a carriage by a soft wrist."""

import mujoco

import cosim

WRIST = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="carriage" pos="0 0 0.5">
      <joint name="aside" type="slide" axis="1 0 0"/>
      <geom type="box" size="0.05 0.05 0.01" mass="3"/>
      <site name="flange" pos="0 0 -0.01" euler="180 0 0"/>
    </body>
    <body name="tool" pos="0 0 0.47">
      <freejoint/>
      <geom type="capsule" fromto="0 0 -0.02 0 0 -0.08" size="0.01" mass="0.1"/>
    </body>
  </worldbody>
  <actuator><position joint="aside" kp="5000" kv="200"/></actuator>
</mujoco>
"""
spec = mujoco.MjSpec.from_string(WRIST)
inflated = {"start.pressure_Pa": 3e3, "solver.damping_per_s": 20.0}
joint = cosim.attach(spec, ("flange", "tool"), "square_core", overrides=inflated)
model = spec.compile()
data = mujoco.MjData(model)
for step in range(100):
    data.ctrl[0] = 1e-4 * step
    joint.step(model, data)
print(joint.far_wrench.force, joint.wrench.force)  # on the tool, on the carriage
