"""Receipts of final results: their form, their place in the public log, and its audit without a server."""
