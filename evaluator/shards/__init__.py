"""Shards of an evaluation: the runners of policies and logs, each in a process of its own."""
