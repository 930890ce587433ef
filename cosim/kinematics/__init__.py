"""The arm's kinematics and dynamics in closed form, by Pinocchio."""

from cosim.errors import InputError

try:
    import coal  # noqa: F401  # here, as its absence is the user's to mend
    import pinocchio  # noqa: F401
except ImportError as error:
    raise InputError(
        f"a robot arm needs Pinocchio and Coal; '{error.name}' cannot be loaded: pip install pin coal; "
        'without an arm set robot = "none", or hang the soft robot on your model by cosim.attach'
    ) from error
