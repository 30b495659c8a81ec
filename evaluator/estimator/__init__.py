"""The standard estimator: plays every sensor of Track 3 alike, calibrated to each, without a policy."""
