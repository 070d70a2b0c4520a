"""Buildings that share a limit or a price of their summed power, each solving its own quadratic programme."""

from __future__ import annotations

from controllers.coordination.admm import Coordination, coordinate
from controllers.coordination.limit import SharedPower
from controllers.coordination.member import Answer, Member, QPMember, Settled
from controllers.coordination.planning import SharedPlans, plan_shared
from controllers.coordination.settling import Agreement

__all__ = [
    "Agreement",
    "Answer",
    "Coordination",
    "Member",
    "QPMember",
    "Settled",
    "SharedPlans",
    "SharedPower",
    "coordinate",
    "plan_shared",
]
