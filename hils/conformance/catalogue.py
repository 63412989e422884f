"""All rules of the wire that a rig is tried against, in the order in which they are tried."""

from hils.conformance.motion_rules import MOVING_RULES
from hils.conformance.rule import Rule
from hils.conformance.safety_rules import SAFETY_RULES
from hils.conformance.session_rules import CLOSING_RULES, HELLO_RULES


def rules(moving: bool) -> tuple[Rule, ...]:
    """The rules, with those that turn the wheel or without them."""
    return (*HELLO_RULES, *SAFETY_RULES, *(MOVING_RULES if moving else ()), *CLOSING_RULES)
