"""Notices to teams by e-mail and webhook: what happened, stored until it is sent."""
