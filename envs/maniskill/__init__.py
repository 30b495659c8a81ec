"""Environments of ManiSkill 3 as tasks: what each is, and the adapter that plays one (extra `maniskill`)."""
