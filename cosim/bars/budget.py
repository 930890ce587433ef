"""The processor time that a study may take."""

import math
import time
from typing import final


class TooDearError(Exception):
    """The processor time that a study may take is spent."""


@final
class Budget:
    """Counts the processor time of this thread.

    Args:
        most_s: bound; infinite: no bound.
    """

    def __init__(self, most_s: float = math.inf) -> None:
        self.most_s, self._began = most_s, time.thread_time()

    @property
    def spent_s(self) -> float:
        """Processor time so far."""
        return time.thread_time() - self._began

    def check(self) -> None:
        """Check that some time is left.

        Raises:
            TooDearError: it is spent.
        """
        if self.spent_s > self.most_s:
            raise TooDearError
