"""Buildings that share a limit or a price of their summed power, planned by one quadratic programme."""

from __future__ import annotations

from controllers.coordination.joint import JointPlan, Member, SharedPower, plan_jointly
from controllers.coordination.planning import SharedPlans, plan_shared

__all__ = ["JointPlan", "Member", "SharedPlans", "SharedPower", "plan_jointly", "plan_shared"]
