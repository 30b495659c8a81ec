"""The part that runs inside the sandbox; `agent.py` is bound there as a single file and imports nothing of ours."""
