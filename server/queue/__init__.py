"""Queue of shards: enqueueing, leases with fencing tokens, sweep of lost work."""
