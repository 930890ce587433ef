"""Compare force and stiffness of the contact law with differences."""

import numpy as np

from cosim.soft.contact.contact_law import ContactLaw
from cosim.soft.contact.obstacle_contact import ContactPlanes
from cosim.soft.elements.element import Sums

law, nudge_m = ContactLaw(smoothing_m=1e-4), 1e-9
plane = ContactPlanes.empty(1, law).changed(
    weights=np.array([[1.0, 0.0, 0.0]]), normal=np.array([[0.0, 0.0, 1.0]]), stiffness=np.array([1e3])
)


def at(depth_m: float) -> tuple[float, float, float]:
    x = np.array([[0.0, 0.0, law.onset_m - depth_m]])
    energy_J = plane.add(x, Sums(np.zeros_like(x)), hessian=False)
    return energy_J, float(plane.normal_force[0]), float(plane.tangent[0, 2, 2])


for depth_m in (2e-5, 1e-4, 4e-4):
    _, force_N, stiffness_N_m = at(depth_m)
    above, below = at(depth_m - nudge_m), at(depth_m + nudge_m)
    differences = [(b - a) / (2.0 * nudge_m) for a, b in zip(above, below, strict=True)]
    assert np.allclose(differences[:2], [force_N, stiffness_N_m], rtol=1e-5), differences
    print(f"{depth_m:g} m: {force_N:.4g} N, {stiffness_N_m:.4g} N/m")
