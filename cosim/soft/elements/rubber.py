"""An incompressible neo-Hookean membrane, such as silicone, whose thickness follows from its area.

With C = 2 E + 1, J = det C (the square of the stretch of area) and the shear modulus mu = E_0 / 3,
    psi = mu t (tr C + 1 / J - 3) / 2,   N = mu t (1 - C^-1 / J).
psi is convex in E. At small strain it is the plain law of Young's modulus E_0 and Poisson's ratio 1/2. A
sphere of drawn radius R has p = 2 mu t / R (1 / l - 1 / l^7), largest at the stretch l = 7^(1/6).
Source: Holzapfel, Nonlinear Solid Mechanics, section 6.5; Mueller and Strehlow, Rubber and Rubber Balloons,
chapter 2.
"""

from __future__ import annotations

from cosim.base.kernels import Matrix, Vector, device_function


@device_function
def neo_hookean(strain: tuple[float, float, float], shear: float, n: Vector, c: Matrix) -> float:
    """Fill n (3,) and c (3, 3), first and second derivative of the energy density by (E11, E22, 2 E12).

    Args:
        strain: E11, E22, 2 E12.
        shear: mu t [N/m].
        n: filled.
        c: filled.

    Returns:
        Energy density [J/m^2]; infinite where the film has no area.
    """
    c11, c22, c12 = 1.0 + 2.0 * strain[0], 1.0 + 2.0 * strain[1], strain[2]
    inverse = 1.0 / (c11 * c22 - c12 * c12)
    square = shear * inverse * inverse
    n[0], n[1], n[2] = shear - square * c22, shear - square * c11, square * c12
    cube = 4.0 * square * inverse
    c[0, 0], c[1, 1], c[2, 2] = cube * c22 * c22, cube * c11 * c11, square + cube * c12 * c12
    c[0, 1] = c[1, 0] = cube * c11 * c22 - 2.0 * square
    c[0, 2] = c[2, 0] = -cube * c22 * c12
    c[1, 2] = c[2, 1] = -cube * c11 * c12
    return 0.5 * shear * (c11 + c22 + inverse - 3.0)
