"""Names of the timelines of a recording, and paths of its entities. In a recording of several arms, the path
of an entity of one arm begins with the arm's name.
"""

from typing import Final

TIMELINE: Final = "sim_time"
TICKS: Final = "tick"
FOLLOW: Final = "/world/follow"
TIP_PATH: Final = "/world/soft/tip_path"
STRESS_SCALE: Final = "/stress_scale"


def path_of_arm(arm: str, path: str) -> str:
    """Return the path of an entity in a recording of several arms: entities of one arm begin with its name.

    Args:
        arm: name of the arm; empty if it is the only one.
        path: of the entity in a recording of a single arm.
    """
    shared = path == "/world" or path.startswith(("/world/rigid/", STRESS_SCALE))
    if not arm or shared:
        return path
    within = path.startswith("/world/")
    return f"/world/{arm}/{path.removeprefix('/world/')}" if within else f"/{arm}{path}"
