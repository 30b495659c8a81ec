"""Uploads in pieces over HTTP, by the protocol tus 1.0."""
