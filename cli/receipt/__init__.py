"""`vitac receipt`: receipts of final results."""
