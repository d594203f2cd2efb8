"""Control beside a policy: it predicts the boat and replaces actions of the policy.

`supervisor` in calm water, `planner` and `safety_filter` in wind and current, which `forecast` estimates.
"""
