"""Notices to teams by e-mail and webhook: what happened, kept until it is sent."""
