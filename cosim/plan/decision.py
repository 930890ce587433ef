"""What a run models or leaves out, and what its state depends on.

One thing that a run models or leaves out.

What a run has been built for and its state depends on: who continues from that state keeps to it.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, final

from cosim.errors import InputError

if TYPE_CHECKING:
    from cosim.config.schema.scenario import Scenario

SECTION_RANGE: Final = "motion within the section model's range"


@final
@dataclass(frozen=True)
class Decision:
    """Whether something is modelled, and why.

    Args:
        what: it is.
        included: whether it is modelled.
        reason: why, or why not.
        switch: key of the scenario that decides otherwise; "body" for a body given from Python.
    """

    what: str
    included: bool
    reason: str
    switch: str

    @property
    def line(self) -> str:
        """The decision in one line."""
        return f"{self.what}: {self.reason} ({self.switch})"


CONTACT: Final = "contact with the scene"
"""What the decision is on."""
OTHER_FILMS: Final = Decision(
    "contact with the films of other arms", False, "they pass through one another; a run looks for it", "arm"
)
CONTACT_ENABLED: Final = "contact.enabled"
ONLY_IN_REACH: Final = "contact.only_in_reach"


@final
@dataclass(frozen=True)
class Choices:
    """What the kind of a run's state follows from.

    Args:
        values: of the scenario, by key.
        contact: whether contact with the scene is modelled, and why.
    """

    values: dict[str, str]
    contact: Decision

    @classmethod
    def of(cls, scenario: "Scenario", contact: Decision) -> "Choices":
        """Return the choices of a scenario, with what has been decided on contact."""
        values: dict[str, str] = {"mode": scenario.mode, "fidelity": scenario.fidelity}
        if scenario.mode == "dynamic":
            values["coupling.scheme"] = scenario.coupling.scheme
        return cls(values, contact)

    def check(self, here: "Choices") -> None:
        """Check that a run with other choices can continue from a state of this one.

        Raises:
            InputError: it cannot; the text names key, both values and what to do.
        """
        for key, value in self.values.items():
            other = here.values.get(key, value)
            if other != value:
                raise InputError(
                    f"{key} is '{other}', in the run whose state it continues from '{value}'; that state is "
                    f"of another kind: leave {key} = '{value}', or restart a run with '{other}'"
                )
        if self.contact.included and not here.contact.included:
            raise InputError(
                f"{here.contact.switch}: contact with the scene is left out ({here.contact.reason}), in the "
                f"run whose state it continues it is modelled ({self.contact.reason}); leave "
                f"{here.contact.switch} as it is there, or restart without contact"
            )
        if here.contact.included and self.contact.switch == CONTACT_ENABLED and not self.contact.included:
            raise InputError(
                f"{CONTACT_ENABLED} is true, in the run whose state it continues from false: the film may be "
                f"inside of touched bodies; leave it false, or restart with {CONTACT_ENABLED} = true"
            )

    def keep(self, contact: Decision) -> Decision:
        """Return the decision on contact of a run that continues from this one.

        What has been left out because nothing was in reach begins untouched where something comes into reach
        now; what has been modelled stays so, with what it touches, though nothing would be in reach any more.

        Args:
            contact: what would be decided again.
        """
        if self.contact.included and contact.switch == ONLY_IN_REACH and not contact.included:
            reason = f"as in the run that it continues from: {self.contact.reason}"
            return Decision(contact.what, True, reason, ONLY_IN_REACH)
        return contact
