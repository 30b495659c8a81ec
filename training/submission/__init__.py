"""The submission that training ends in: the policy, which training imports too, and how a run becomes one."""
