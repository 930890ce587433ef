"""Decisions of a run on the effects that it models, with their reasons, and the settings that a continued run
must keep.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, final

from cosim.errors import InputError

if TYPE_CHECKING:
    from cosim.config.schema.scenario import Scenario

SECTION_RANGE: Final = "motion within the section model's range"
CONTACT: Final = "contact with the scene"
"""Effect of the decision on contact."""
CONTACT_ENABLED: Final = "contact.enabled"
ONLY_IN_REACH: Final = "contact.only_in_reach"


@final
@dataclass(frozen=True)
class Decision:
    """Whether an effect is modelled, and why.

    Args:
        what: the effect.
        included: whether it is modelled.
        reason: why, or why not.
        switch: key of the scenario that changes the decision; "body" for a body given from Python.
    """

    what: str
    included: bool
    reason: str
    switch: str

    @property
    def line(self) -> str:
        """The decision in one line."""
        return f"{self.what}: {self.reason} ({self.switch})"


OTHER_FILMS: Final = Decision(
    "contact with the films of other arms", False, "they pass through one another; a run looks for it", "arm"
)


@final
@dataclass(frozen=True)
class Choices:
    """Settings of a run that a run which continues from its state must keep.

    Args:
        values: of the scenario, by key.
        contact: decision on contact with the scene.
    """

    values: dict[str, str]
    contact: Decision

    @classmethod
    def of(cls, scenario: "Scenario", contact: Decision) -> "Choices":
        """Return the settings of a scenario, with the decision on contact."""
        values: dict[str, str] = {"mode": scenario.mode, "fidelity": scenario.fidelity}
        if scenario.mode == "dynamic":
            values["coupling.scheme"] = scenario.coupling.scheme
        return cls(values, contact)

    def check(self, here: "Choices") -> None:
        """Check that a run with other settings can continue from a state of this run.

        Args:
            here: settings of the run that continues.

        Raises:
            InputError: it cannot; the message names key, both values and the remedy.
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

        If this run models contact, the continuing run does so as well, even if nothing is in reach.

        Args:
            contact: decision of the continuing run without this rule.
        """
        if self.contact.included and contact.switch == ONLY_IN_REACH and not contact.included:
            reason = f"as in the run that it continues from: {self.contact.reason}"
            return Decision(contact.what, True, reason, ONLY_IN_REACH)
        return contact
