"""Laboratories whose agents play trials for the service."""
