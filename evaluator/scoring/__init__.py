"""Pure functions of records: score, confidence interval, ranking."""
