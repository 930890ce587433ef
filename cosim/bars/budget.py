"""How much processor time a study may take: as long as it is asked for, or a share of what the run took."""

import math
import time
from typing import final


class TooDearError(Exception):
    """All the processor time that a study may take is spent."""


@final
class Budget:
    """Counts the processor time of this thread from now on.

    Args:
        most_s: that may be spent; infinite: as much as it takes.
    """

    def __init__(self, most_s: float = math.inf) -> None:
        self.most_s, self._began = most_s, time.thread_time()

    @property
    def spent_s(self) -> float:
        """Processor time so far."""
        return time.thread_time() - self._began

    def check(self) -> None:
        """Do nothing as long as something is left.

        Raises:
            TooDearError: nothing is.
        """
        if self.spent_s > self.most_s:
            raise TooDearError
