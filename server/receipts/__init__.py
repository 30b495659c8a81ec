"""Receipts of final results: their form, the chain that they make, and the audit of it without a server."""
