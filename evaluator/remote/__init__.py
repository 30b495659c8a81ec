"""Policies that play from elsewhere: a policy server on a participant's own machine, asked over a websocket."""
