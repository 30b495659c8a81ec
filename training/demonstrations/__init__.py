"""Demonstrations of an expert that knows the truth, which replay to the bit, and data sets of them."""
