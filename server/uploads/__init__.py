"""Uploads: received, checked by all rules of their kind, stored."""
