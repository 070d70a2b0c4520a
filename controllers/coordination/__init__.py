"""Buildings that share a limit or a price of their summed power, planned by one quadratic programme."""

from __future__ import annotations

from controllers.coordination.planning import JointPlan, Member, SharedPlans, SharedPower, plan_jointly, plan_shared

__all__ = ["JointPlan", "Member", "SharedPlans", "SharedPower", "plan_jointly", "plan_shared"]
